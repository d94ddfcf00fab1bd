"""``cosim tell``: start, stop, arm, reset or query nodes on Zenoh."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import Deploy
from cosim.cli.options import Set

if TYPE_CHECKING:
    from bridge.deployment.system import System

#: s; what `options.wait` of the bus is here where nodes do not wait for each other.
PATIENCE = 3.0


def tell(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    what: Annotated[
        str,
        typer.Argument(help="Command: start, stop, arm, reset; query: state, parameters, clock."),
    ],
    deploy: Deploy = "",
    node: Annotated[str, typer.Option("--node", help="Node to address. Default: all.")] = "",
    as_: Annotated[
        str, typer.Option("--as", help="Certificate to use, if TLS is enabled.")
    ] = "operator",
    set_: Set = None,
) -> None:
    """Send a command or a query to the nodes of a deployment, and print their answers.

    A start waits until all addressed nodes are ready (`patience` of the deployment), and other
    commands until the nodes are present (`options.wait`); a stop does not wait. A start gives all
    nodes that share a clock the same t = 0; if some nodes are already running, the others join
    them.
    """
    from bridge.deployment.system import load_system
    from cosim.base.errors import ScenarioError

    system = load_system(scenario, deploy, set_ or [])
    d = system.deployment
    bus = next((name for name, b in d.buses.items() if b.kind == "zenoh"), "")
    if not bus:
        raise ScenarioError(
            "no Zenoh bus; nodes on CAN are controlled by NMT frames, others by the deployment "
            "that they run (--deploy)",
            d.place("buses"),
        )
    there = [n for n in d.nodes if bus in system.buses_of(n)]
    if node and node not in there:
        raise ScenarioError(f"no node {node!r} on {bus}; there are: {', '.join(there)}")
    _tell(system, bus, what, [node] if node else there, as_, every=not node)


def _tell(
    system: System, bus: str, what: str, nodes: Sequence[str], name: str, *, every: bool
) -> None:
    from bridge.deployment.zenoh_keys import names_of
    from bridge.zenoh.node_channel import rules_of
    from bridge.zenoh.offsets import announce_epoch
    from bridge.zenoh.options import options_of
    from bridge.zenoh.presence import Presence, wait_until_there
    from bridge.zenoh.remote_control import READ, ask, command, wait_until_ready
    from bridge.zenoh.session import close_session, configure, open_session

    d = system.deployment
    names, nmt = names_of(d, bus), system.services[bus].nmt
    options, number = options_of(d, bus, name), 0 if every else d.nodes[nodes[0]].number
    session = open_session(configure(options, name, rules_of(system, bus)), bus)
    try:
        if what in READ:
            found = {n: ask(session, names, n, what) for n in nodes}
            typer.echo(json.dumps(found, indent=2))
        else:
            assert nmt is not None  # a Zenoh bus has one
            if what == "stop":  # those it reaches already
                command(session, names, nmt, what, number)
            if what == "start":
                wait_until_ready(session, names, nodes, name, d.patience)
                for warning in announce_epoch(session, system, bus):
                    typer.echo(f"warning: {warning}", err=True)
            else:
                present = Presence(session, names, name)
                wait_until_there(lambda: present.missing(nodes, {}), options.wait or PATIENCE)
            command(session, names, nmt, what, number)
    finally:
        close_session(session)
