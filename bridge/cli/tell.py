"""``cosim tell``: nodes on Zenoh started, stopped, armed, reset, or asked how they are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from bridge.deployment.system import System

#: s; what `options.wait` of the bus is here where nodes do not wait for each other.
PATIENCE = 3.0


def tell(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (.toml).")],
    what: Annotated[
        str, typer.Argument(help="start, stop, arm, reset (NMT); state, parameters, clock (asked).")
    ],
    deploy: Annotated[str, typer.Option("--deploy", help="Deployment: file or name.")] = "zenoh",
    node: Annotated[str, typer.Option("--node", help="Which node; all if not said.")] = "",
    as_: Annotated[
        str, typer.Option("--as", help="Name of the certificate, where there are any.")
    ] = "operator",
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="PATH=VALUE", help="Change a value.")
    ] = None,
) -> None:
    """Give a command to the nodes of a deployment, or ask them; prints what they answer.

    A start waits until all nodes it is for are ready (`patience` of the deployment), other
    commands until they are there (`options.wait`); a stop does not wait. A start tells all nodes
    one t = 0 where they share a clock; where some run already, the others join them.
    """
    from bridge.deployment.system import load_system
    from cosim.base.errors import ScenarioError

    system = load_system(scenario, deploy, set_ or [])
    d = system.deployment
    bus = next((name for name, b in d.buses.items() if b.kind == "zenoh"), "")
    if not bus:
        raise ScenarioError("no Zenoh bus; nodes on CAN are told by NMT frames", d.place("buses"))
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
