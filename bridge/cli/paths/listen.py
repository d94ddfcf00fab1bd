"""``cosim ping listen``: the figures of traffic that is only listened to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cosim.cli.options import write_json

if TYPE_CHECKING:
    from bridge.cli.paths.path import EndOptions
    from bridge.ping.listening import HeardStreams


def ping_listen(
    target: Sequence[str], *, identifier: str, connect: str, duration: float,
    json: Path | None,
    end: EndOptions,
) -> None:  # fmt: skip
    """Listen to ``can CHANNEL`` or ``zenoh KEY`` for `duration` (s; 0: until Ctrl-C), and print.

    Raises ScenarioError for what is neither, RunError if nothing was heard.
    """
    from bridge.ping.listening import HeardStreams, stream_lines, stream_values
    from cosim.base.clock import monotonic_ns
    from cosim.base.errors import RunError, ScenarioError
    from cosim.base.interrupts import act_on_signal, until_signal

    if len(target) != 2 or target[0] not in ("can", "zenoh"):
        raise ScenarioError(
            f"found {' '.join(target)!r}; expected can CHANNEL or zenoh KEY", "cosim ping listen"
        )
    heard = HeardStreams()
    stop = monotonic_ns() + round(duration * 1e9) if duration else 1 << 62
    kind, where = target
    opened = (
        _can(where, identifier, end, heard) if kind == "can" else _zenoh(where, connect, end, heard)
    )
    with opened as listen, until_signal():
        while monotonic_ns() < stop:
            act_on_signal()
            listen(min(stop, monotonic_ns() + 200_000_000))
    figures = heard.figures()
    if not figures:
        counts = sum(heard.counts.values())
        raise RunError(
            f"{kind} {where}: {counts} samples heard; expected at least three of one stream"
        )
    if json is not None:
        write_json(json, "ping", {"streams": {n: stream_values(f) for n, f in figures.items()}})
    for name, f in figures.items():
        typer.echo("\n".join(stream_lines(name, f)))
    if heard.ignored:
        typer.echo(f"{heard.ignored} samples of further streams are not counted")


@contextmanager
def _can(
    channel: str, identifier: str, end: EndOptions, heard: HeardStreams
) -> Iterator[Callable[[int], None]]:
    """A function that listens until a time; only `identifier` (hexadecimal), if it is given."""
    from bridge.can.plain import PlainBus
    from bridge.cli.paths.path import can_bus
    from bridge.native.frame import Flags
    from bridge.ping.listening import StreamSample
    from cosim.base.clock import realtime_ns
    from cosim.base.errors import ScenarioError

    try:
        wanted = int(identifier, 16) if identifier else None
    except ValueError:
        raise ScenarioError(
            f"found --id {identifier!r}; expected a hexadecimal identifier, as 123 or 0x123"
        ) from None
    bus = PlainBus(can_bus(channel, end.interface, end.bitrate))

    def listen(until_ns: int) -> None:
        while (found := bus.receive(until_ns)) is not None:
            if found.frame.flags & Flags.ERROR or wanted not in (None, found.frame.id):
                continue
            name = f"{found.frame.id:0{8 if found.frame.flags & Flags.EXTENDED else 3}X}"
            heard.add(name, StreamSample(found.t_ns, realtime_ns() - found.wake_ns))

    try:
        yield listen
    finally:
        bus.close()


@contextmanager
def _zenoh(
    key: str, connect: str, end: EndOptions, heard: HeardStreams
) -> Iterator[Callable[[int], None]]:
    """A function that waits until a time, while a subscriber listens."""
    from bridge.ping.listening import zenoh_sample
    from bridge.zenoh.exchange import listening, plain_session
    from cosim.base.clock import monotonic_ns, realtime_ns, sleep

    def came(
        name: str, payload: bytes, attached: bytes | None, stamp: int | None, t_ns: int
    ) -> None:
        date = realtime_ns() - (monotonic_ns() - t_ns)
        heard.add(name, zenoh_sample(name, payload, attached, stamp, t_ns, date))

    with (
        plain_session(connect or "tcp/localhost:7447", end.config) as session,
        listening(session, key, came),
    ):
        yield lambda until_ns: sleep((until_ns - monotonic_ns()) * 1e-9)
