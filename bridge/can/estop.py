"""Emergency stop from outside: ``python -m bridge.can.estop -i socketcan -c vcan0``.

Sends the ESTOP frame every 10 ms until SIGTERM or SIGINT, or for a given time. Every node that
receives it ramps its torque down, latches the stop, and forwards it to its other buses. Buses are
named as in python-can; ``udp_multicast`` stays on this machine.

This is a frame on a bus. It does not replace an emergency stop that cuts the power without
software.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from bridge.can.interface import attach, parse_spec
from bridge.can.repeated_frame import repeat, stopped_by_signals
from cosim.base.errors import CosimError
from cosim.base.streams import end_with

#: Of ESTOP in every DBC file of the project; bytes: node (0: none), reasons.
IDENTIFIER, LENGTH, RATE = 0x001, 5, 100.0


def main(arguments: Sequence[str] | None = None) -> int:
    """0, and a line with what was sent; 2: the bus cannot be opened."""
    parser = argparse.ArgumentParser(
        prog="python -m bridge.can.estop",
        description="Send ESTOP every 10 ms; the bus is named as for python-can (-i, -c).",
        allow_abbrev=False,
    )
    parser.add_argument("--seconds", type=float, help="how long (default: until a signal)")
    given, rest = parser.parse_known_args(arguments)
    try:
        attachment = attach(parse_spec("estop", rest), accepts=())
    except CosimError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_code
    frames = None if given.seconds is None else round(given.seconds * RATE)
    try:
        with stopped_by_signals() as stop:
            sent, failed = repeat(attachment.bus, IDENTIFIER, RATE, LENGTH, frames, stop)
    finally:
        attachment.close()
    sys.stdout.write(f"{sent} ESTOP frames sent, {failed} not taken\n")
    return 0


if __name__ == "__main__":
    end_with(main)
