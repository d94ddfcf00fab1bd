"""A babbling peer: ``python -m bridge.rehearsal.babbler -i socketcan -c vcan0 --id 0x10 --rate
2000``.

Sends frames of one identifier at a rate until SIGTERM or SIGINT, or for a given time. The data is a
counter. Frames that the bus does not accept are counted and not repeated. Buses are named as in
python-can (``-i``, ``-c``, ``--fd`` ...); ``udp_multicast`` stays on this machine.
"""

from __future__ import annotations

import argparse
import ctypes as c
import select
import sys
from collections.abc import Sequence

from bridge.can.interface import attach, parse_spec
from bridge.can.repeated_frame import LONGEST_WAIT, flags_of, repeat, stopped_by_signals
from bridge.faults.script import FaultEvent
from bridge.native.bus import FORMAT, Accept
from cosim.base.errors import CosimError
from cosim.base.python import python_call


def command(event: FaultEvent, interface: str, channel: str, *, fd: bool = False) -> list[str]:
    """The command that starts the peer that an event of a fault script asks for."""
    said = python_call("bridge.rehearsal.babbler", "-i", interface, "-c", channel)
    said += ["--id", f"{event.id:#x}", "--rate", f"{event.rate:g}", "--length", f"{event.length}"]
    return [*said, "--fd"] if fd else said


def accept(event: FaultEvent) -> Accept:
    """The frames that such a peer sends, by identifier and format."""
    return Accept(
        event.id & 0x1FFFFFFF, flags=flags_of(event.id, event.length) & FORMAT, flag_mask=FORMAT
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
                _wait_for_end(stop)
            done = repeat(attachment.bus, given.id, given.rate, given.length, frames, stop)
    finally:
        attachment.close()
    sys.stdout.write(f"{done[0]} frames sent, {done[1]} not taken\n")
    return 0


def _wait_for_end(stop: c.c_int32) -> None:
    """Wait for a line on standard input, or for a signal."""
    while not stop.value and not select.select([sys.stdin], [], [], LONGEST_WAIT * 1e-9)[0]:
        pass


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m bridge.rehearsal.babbler",
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
