"""The router's process: ``python -m bridge.relay JSON``; commands come as lines of JSON.

``{"link": "a>b", "spec": {...}}`` changes a link, ``*``: all. It ends with its standard input.
"""

from __future__ import annotations

import gc
import json
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from bridge.native.journal import Journal
from bridge.relay.impairment import RelayLinkSpec
from bridge.relay.router import PACKET, Router, open_tun
from cosim.base.clock import monotonic_ns
from cosim.base.errors import CosimError


def main(arguments: Sequence[str]) -> int:
    """Serve until standard input ends. Returns the exit code."""
    given = json.loads(arguments[0])
    try:
        tuns = {h["name"]: open_tun(h["namespace"], h["address"]) for h in given["hosts"]}
        addresses = {h["name"]: h["address"] for h in given["hosts"]}
        with Journal.create(Path(given["record"]), np.dtype(PACKET), given["rows"]) as record:
            router = Router(tuns, addresses, given["seed"], record, monotonic_ns())
            for link, spec in given["links"].items():
                router.set(link, RelayLinkSpec.of(spec, link))
            _say({"event": "ready", "links": list(router.links)})
            gc.freeze()
            gc.disable()  # a collection would hold packets back
            router.run(monotonic_ns, sys.stdin.fileno(), _commands(router))
    except CosimError as error:
        _say({"event": "failed", "error": str(error)})
        return error.exit_code
    return 0


def _commands(router: Router) -> Callable[[], bool]:
    """Reads what has come; False: standard input has ended."""
    rest = b""

    def read() -> bool:
        nonlocal rest
        data = os.read(sys.stdin.fileno(), 65536)
        *lines, rest = (rest + data).split(b"\n")
        for line in lines:
            told = json.loads(line)
            router.set(told["link"], RelayLinkSpec.of(told["spec"], told["link"]))
        return bool(data)

    return read


def _say(event: object) -> None:
    sys.stdout.write(json.dumps(event) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
