"""A Zenoh router as a process: ``python -m bridge.zenoh.router FILE ENDPOINT ...``.

It serves nodes in client mode if no zenohd is available. It prints ``ready`` on standard output,
and ends when its standard input is closed or on SIGTERM. With ``--insecure`` it may listen without
encryption beyond this machine; ``--keys FOLDER`` replaces ``{keys}`` in the file, and ``--connect
ENDPOINT`` joins it to another router; repeatable.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from bridge.zenoh.options import ZenohOptions, check_endpoint
from bridge.zenoh.session import close_session, configure, open_session
from cosim.base.errors import CosimError


def main(arguments: Sequence[str]) -> int:
    """Route until standard input ends. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="bridge.zenoh.router")
    parser.add_argument("file", type=Path)
    parser.add_argument("listen", nargs="+")
    parser.add_argument("--connect", action="append", default=[], metavar="ENDPOINT")
    parser.add_argument("--insecure", action="store_true")
    parser.add_argument("--keys", type=Path, default=Path("keys"))
    given = parser.parse_args(arguments)
    try:
        for endpoint in (*given.listen, *given.connect):
            check_endpoint(endpoint, "router", insecure=given.insecure)
        options = ZenohOptions(
            "router",
            tuple(given.listen),
            tuple(given.connect),
            config=given.file,
            keys=given.keys,
            insecure=given.insecure,
        )
        session = open_session(configure(options, "router"), "router")
    except CosimError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    signal.signal(signal.SIGTERM, _terminated)
    try:
        while sys.stdin.buffer.read(4096):
            pass
    except SystemExit:
        pass
    close_session(session)
    return 0


def _terminated(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
