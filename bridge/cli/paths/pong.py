"""``cosim pong``: the other end of ``cosim ping``."""

from __future__ import annotations

from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.cli.options import PingDeployment
from bridge.cli.paths.path import LineOptions
from cosim.cli.options import Set, finite

if TYPE_CHECKING:
    from bridge.ping.can import CanResponder
    from bridge.ping.exchanges import PingPath


def pong(
    line: LineOptions,
    path: Annotated[
        str, typer.Argument(help="Kind of path: udp, zenoh or can; or a scenario file (.toml).")
    ] = "udp",
    where: Annotated[
        str,
        typer.Argument(
            help="udp: HOST:PORT, default all addresses; zenoh: an endpoint; can: a channel; "
            "scenario: the node that answers, default the second one."
        ),
    ] = "",
    connect: Annotated[
        bool, typer.Option("--connect", help="zenoh: connect to a router instead of listening.")
    ] = False,
    deploy: PingDeployment = "zenoh",
    set_: Set = None,
    for_: Annotated[
        float | None,
        typer.Option("--for", callback=finite, min=0.001, help="End after this time, s."),
    ] = None,
) -> None:
    """Answer the questions of cosim ping, until Ctrl-C."""
    from bridge.ping.measure import PingResponder
    from cosim.base.clock import monotonic_ns
    from cosim.base.errors import ScenarioError
    from cosim.base.interrupts import act_on_signal, until_signal

    scenario = path.endswith(".toml")
    if not (scenario or path in ("udp", "zenoh", "can")) or (path == "can" and not where):
        raise ScenarioError(
            f"found {f'{path} {where}'.strip()!r}; expected udp, zenoh, can CHANNEL, or a "
            "scenario file (.toml)",
            "cosim pong",
        )
    with ExitStack() as stack:
        responder: CanResponder | PingResponder
        if path == "can":
            responder = _can(where, line.interface, line.bitrate, stack)
        else:
            opened = (
                _node(Path(path), where, deploy, set_ or [])
                if scenario
                else _udp(where)
                if path == "udp"
                else _zenoh(where, line.config, connect)
            )
            responder = PingResponder(stack.enter_context(opened))
        stop = None if for_ is None else monotonic_ns() + round(for_ * 1e9)
        with until_signal():
            while stop is None or monotonic_ns() < stop:
                act_on_signal()
                turn = monotonic_ns() + 500_000_000
                responder.serve(turn if stop is None else min(turn, stop))
    typer.echo(f"{responder.answered} questions answered")


def _udp(where: str) -> AbstractContextManager[PingPath]:
    from contextlib import closing

    from bridge.ping.udp import PORT, UdpPath, parse_address

    host, port = parse_address(where) if where else ("", PORT)
    end = UdpPath((host, port), listen=True)
    shown = f"{host}:{end.port}" if host else f"port {end.port} of all addresses"
    typer.echo(f"udp {shown} answers; Ctrl-C ends it", err=True)
    return closing(end)


def _zenoh(where: str, config: Path | None, connect: bool) -> AbstractContextManager[PingPath]:
    from bridge.ping.zenoh import zenoh_responder
    from bridge.zenoh.exchange import ENDPOINT

    endpoint = where or ENDPOINT
    opened = zenoh_responder(endpoint, config, listen=not connect)
    typer.echo(f"zenoh {endpoint} answers; Ctrl-C ends it", err=True)
    return opened


def _node(
    scenario: Path, node: str, deploy: str, settings: list[str]
) -> AbstractContextManager[PingPath]:
    from bridge.deployment.system import load_system
    from bridge.ping.zenoh import node_responder, pinged_nodes

    nodes = pinged_nodes(load_system(scenario, deploy, settings), there=node)
    typer.echo(f"{nodes.there} answers; Ctrl-C ends it", err=True)
    return node_responder(nodes)


def _can(channel: str, interface: str, bitrate: float | None, stack: ExitStack) -> CanResponder:
    from bridge.cli.paths.path import can_bus
    from bridge.ping.can import ASK, CanPath, CanQuestion, CanResponder

    answers = CanQuestion(ASK + 1, b"", ASK)
    path = CanPath(can_bus(channel, interface, bitrate), answers, ASK)
    stack.callback(path.close)
    typer.echo(f"can {channel} ({interface}) answers; Ctrl-C ends it", err=True)
    return CanResponder(path)
