"""``cosim tell``: nodes on Zenoh started, stopped, armed, reset, or asked how they are."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    import zenoh

    from bridge.system import System

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
    from bridge.system import load_system
    from cosim.errors import ScenarioError

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
    from bridge.zenoh.attach import rules_of
    from bridge.zenoh.names import names_of
    from bridge.zenoh.options import options_of
    from bridge.zenoh.presence import Presence, wait_until_there
    from bridge.zenoh.remote import READ, ask, command, wait_until_ready
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
                _epoch(system, bus, session)
            else:
                present = Presence(session, names, name)
                wait_until_there(lambda: present.missing(nodes, {}), options.wait or PATIENCE)
            command(session, names, nmt, what, number)
    finally:
        close_session(session)


def _epoch(system: System, bus: str, session: zenoh.Session) -> None:
    """Say one t = 0 to all, unless a run goes on, which who starts now joins."""
    from bridge.clocks import host_clock
    from bridge.native.epoch import new_run, values
    from bridge.zenoh.names import names_of
    from bridge.zenoh.offsets import bearable, judge, lead, measure
    from bridge.zenoh.presence import present_now
    from bridge.zenoh.remote import say
    from cosim.clock import realtime_ns

    names, ours, epoch = names_of(system.deployment, bus), host_clock(), system.services[bus].epoch
    assert epoch is not None  # a Zenoh bus has one
    there = sorted(present_now(session, names) & set(system.nodes))
    found = [measure(session, names, node, ours) for node in there]
    for warning in judge(system.deployment, found, bearable(system)):
        typer.echo(f"warning: {warning}", err=True)
    if not any(one.running for one in found):
        origin = realtime_ns() + round(lead(found) * 1e9)
        said = values(new_run(origin), ours.number, ours.kept, origin)
        say(session, names.shared("epoch"), epoch, said)
