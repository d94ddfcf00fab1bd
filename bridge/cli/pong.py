"""``cosim pong``: the other end of ``cosim ping``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.cli.numbers import finite

if TYPE_CHECKING:
    from bridge.ping.exchanges import PingPath


def pong(
    path: Annotated[str, typer.Argument(help="Kind of path: udp or zenoh.")] = "udp",
    where: Annotated[
        str,
        typer.Argument(
            help="udp: HOST:PORT to listen on, default all addresses; zenoh: an endpoint."
        ),
    ] = "",
    connect: Annotated[
        bool, typer.Option("--connect", help="zenoh: connect to a router instead of listening.")
    ] = False,
    config: Annotated[
        Path | None, typer.Option(help="zenoh: session configuration (JSON5), for TLS.")
    ] = None,
    for_: Annotated[
        float | None,
        typer.Option("--for", callback=finite, min=0.001, help="End after this time, s."),
    ] = None,
) -> None:
    """Answer the questions of cosim ping, until Ctrl-C."""
    from bridge.ping.measure import PingResponder
    from cosim.base.clock import monotonic_ns
    from cosim.base.errors import ScenarioError

    if path not in ("udp", "zenoh"):
        raise ScenarioError(f"found path {path!r}; expected udp or zenoh", "cosim pong")
    with _udp(where) if path == "udp" else _zenoh(where, config, connect) as end:
        responder = PingResponder(end)
        stop = None if for_ is None else monotonic_ns() + round(for_ * 1e9)
        try:
            while stop is None or monotonic_ns() < stop:
                turn = monotonic_ns() + 500_000_000
                responder.serve(turn if stop is None else min(turn, stop))
        except KeyboardInterrupt:
            pass
    typer.echo(f"{responder.answered} questions answered")


def _udp(where: str) -> AbstractContextManager[PingPath]:
    from contextlib import closing

    from bridge.ping.udp import PORT, UdpPath, parse_address

    host, port = parse_address(where) if where else ("0.0.0.0", PORT)
    end = UdpPath((host, port), listen=True)
    typer.echo(f"udp {host}:{end.port} answers; Ctrl-C ends it", err=True)
    return closing(end)


def _zenoh(where: str, config: Path | None, connect: bool) -> AbstractContextManager[PingPath]:
    from bridge.ping.zenoh import zenoh_responder
    from bridge.zenoh.exchange import ENDPOINT

    endpoint = where or ENDPOINT
    opened = zenoh_responder(endpoint, config, listen=not connect)
    typer.echo(f"zenoh {endpoint} answers; Ctrl-C ends it", err=True)
    return opened
