"""A babbling peer: ``python -m bridge.babble -i socketcan -c vcan0 --id 0x10 --rate 2000``.

Sends frames of one identifier at a rate until it is told to stop (SIGTERM, SIGINT), or for so many
seconds. The data is a counter. What the bus does not take is counted and not sent again. Buses are
named as python-can users know them (``-i``, ``-c``, ``--fd`` ...); ``udp_multicast`` stays on this
machine.
"""

from __future__ import annotations

import argparse
import ctypes as c
import select
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from bridge.can.interface import attach, parse_spec
from bridge.fault_script import EXTENDED, Event
from bridge.native import pace
from bridge.native.bus import FORMAT, Accept, Bus
from bridge.native.frame import Flags, Frame
from cosim.errors import CosimError

LONGEST_WAIT = 50_000_000  # ns; a signal is answered within


def command(event: Event, interface: str, channel: str, *, fd: bool = False) -> list[str]:
    """What starts the peer that an event of a fault script asks for."""
    said = [sys.executable, "-m", "bridge.babble", "-i", interface, "-c", channel]
    said += ["--id", f"{event.id:#x}", "--rate", f"{event.rate:g}", "--length", f"{event.length}"]
    return [*said, "--fd"] if fd else said


def babble(
    bus: Bus, identifier: int, rate: float, length: int, frames: int | None, stop: c.c_int32
) -> tuple[int, int]:
    """Send `rate` frames a second of `length` bytes until `stop` is not 0, or so many.

    `identifier`: bit 31 makes it a 29-bit one. More than 8 bytes: CAN FD. Late ones are caught up.
    Returns how many were sent, and how many were not taken.
    """
    frame = Frame.of(identifier & 0x1FFFFFFF, bytes(length), _flags(identifier, length))
    start, k, failed = pace.now(), 0, 0
    while (frames is None or k < frames) and not stop.value:
        deadline = start + round(k * 1e9 / rate)
        while pace.now() < deadline and not stop.value:
            pace.wait(min(deadline, pace.now() + LONGEST_WAIT), 0, stop)
        frame.data[: min(length, 4)] = k.to_bytes(8, "little")[: min(length, 4)]
        frame.t_ns = 0
        failed += bus.send(frame) != 0
        k += 1
    return k - failed, failed


def _flags(identifier: int, length: int) -> int:
    long = identifier & EXTENDED or identifier & 0x1FFFFFFF > 0x7FF
    return (Flags.EXTENDED if long else 0) | (Flags.FD | Flags.BRS if length > 8 else 0)


def accept(event: Event) -> Accept:
    """The frames that such a peer sends, by identifier and format."""
    return Accept(
        event.id & 0x1FFFFFFF, flags=_flags(event.id, event.length) & FORMAT, flag_mask=FORMAT
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """0, a line when it begins and one with what was sent; 2: the bus cannot be opened."""
    given, rest = _parser().parse_known_args(arguments)
    try:
        attachment = attach(parse_spec("babble", rest), accepts=())
    except CosimError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_code
    frames = None if given.seconds is None else round(given.seconds * given.rate)
    try:
        with stopped_by_signals() as stop:
            sys.stdout.write(f"sending {given.id:#x} {given.rate:g} times a second\n")
            sys.stdout.flush()
            if given.hold:
                _held(stop)
            done = babble(attachment.bus, given.id, given.rate, given.length, frames, stop)
    finally:
        attachment.close()
    sys.stdout.write(f"{done[0]} frames sent, {done[1]} not taken\n")
    return 0


def _held(stop: c.c_int32) -> None:
    """Wait for a line on standard input, or for a signal."""
    while not stop.value and not select.select([sys.stdin], [], [], LONGEST_WAIT * 1e-9)[0]:
        pass


@contextmanager
def stopped_by_signals() -> Iterator[c.c_int32]:
    """A flag for C that is not 0 once SIGTERM or SIGINT has come."""
    stop = c.c_int32(0)

    def told(*_: object) -> None:
        stop.value = 1

    before = {s: signal.signal(s, told) for s in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m bridge.babble",
        description="Send frames of one identifier; the bus is named as for python-can (-i, -c).",
        allow_abbrev=False,
    )
    parser.add_argument("--id", type=lambda text: int(text, 0), required=True)
    parser.add_argument("--rate", type=float, required=True, help="frames a second")
    parser.add_argument("--length", type=int, default=8, help="bytes of data (default 8)")
    parser.add_argument("--hold", action="store_true", help="wait for a line on standard input")
    parser.add_argument("--seconds", type=float, help="how long (default: until a signal)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
