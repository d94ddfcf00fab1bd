"""A Zenoh router as a process: ``python -m bridge.zenoh.router FILE ENDPOINT ...``.

It serves nodes in client mode if no zenohd is available. It prints ``ready`` on standard output,
and ends when its standard input is closed or on SIGTERM. With ``--insecure`` it may listen without
encryption beyond this machine; ``--keys FOLDER`` replaces ``{keys}`` in the file, ``--name NAME``
``{node}``, and ``--connect ENDPOINT`` joins it to another router; repeatable. With ``--tell`` it
prints its Zenoh id and those of the routers that it is connected to, a line for each connection
that is made or lost, however soon another one takes its place.
"""

from __future__ import annotations

import argparse
import os
import select
import signal
import sys
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import FrameType

import zenoh

from bridge.zenoh.options import ZenohOptions, check_endpoint
from bridge.zenoh.session import close_session, configure, open_session
from cosim.base.errors import CosimError

#: s between two looks at the other routers.
LOOK = 0.25


def main(arguments: Sequence[str]) -> int:
    """Route until standard input ends. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="bridge.zenoh.router")
    parser.add_argument("file", type=Path)
    parser.add_argument("listen", nargs="+")
    parser.add_argument("--connect", action="append", default=[], metavar="ENDPOINT")
    parser.add_argument("--insecure", action="store_true")
    parser.add_argument("--tell", action="store_true")
    parser.add_argument("--name", default="router")
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
        session = open_session(configure(options, given.name), "router")
    except CosimError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    _print("ready")
    signal.signal(signal.SIGTERM, _terminated)
    with suppress(SystemExit):
        _route(session, tell=given.tell)
    close_session(session)
    return 0


def _route(session: zenoh.Session, *, tell: bool) -> None:
    """Until standard input ends."""
    own, told, lost = str(session.info.zid()), [""], deque[str]()

    def heard(event: zenoh.TransportEvent) -> None:
        if event.kind == zenoh.SampleKind.DELETE:
            lost.append(str(event.transport.zid))

    with session.info.declare_transport_events_listener(heard):
        while not select.select([0], [], [], LOOK if tell else None)[0] or os.read(0, 4096):
            gone = [lost.popleft() for _ in range(len(lost))]
            others = sorted(map(str, session.info.routers_zid()))
            for now in ([name for name in others if name not in gone], others):
                if tell and now != told:
                    told = now
                    _print(" ".join([own, *told]))


def _print(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _terminated(number: int, frame: FrameType | None) -> None:
    raise SystemExit(0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
