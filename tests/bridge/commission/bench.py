"""Strict drives in a thread, on a bus of python-can, and the line of `cosim doctor` to them."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any

import can

from bridge.commission.drive_line import DriveLine
from bridge.commission.line_drives import LineDrive, line_drives
from bridge.deployment import spec as deployments
from tests.strict_drives.__main__ import arguments, made, serve
from tests.strict_drives.cases import CASES, relaxed
from tests.strict_drives.core import EventLog, StrictDrive

#: ms, of watchdogs: a busy machine feeds later than an idle one.
WATCHDOG = 250
_NUMBERS = count()


@dataclass
class Bench:
    """The drives of one arm by number, their line, and what the doctor knows of them."""

    drives: dict[int, StrictDrive]
    line: DriveLine
    known: list[LineDrive]
    log: io.StringIO

    def events(self, number: int, kind: str) -> list[dict[str, Any]]:
        """The entries of one kind that a drive has logged."""
        lines = [json.loads(line) for line in self.log.getvalue().splitlines()]
        return [e for e in lines if (e["drive"], e["event"]) == (number, kind)]


@contextmanager
def bench(name: str, folder: Path, *words: str, first: int = 1) -> Iterator[Bench]:
    """The left arm of a case (`tests.strict_drives.cases`), of which `first` drives are there.

    `words`: further arguments of the strict drives.
    """
    case = relaxed(CASES[name], folder, WATCHDOG)
    numbers = case.drives[0][:first]
    channel = f"doctor {next(_NUMBERS)}"
    settings = [
        f'buses.left.{k}="{v}"' for k, v in (("interface", "virtual"), ("channel", channel))
    ]
    d = deployments.load(case.deploy, settings)
    known = [x for x in line_drives(d) if x.foreign.bus == "left" and x.foreign.node in numbers]
    single = [w.split(",")[0] if i and case.words[i - 1] != "--drives" else w
              for i, w in enumerate(case.words)]  # fmt: skip
    log, ended = io.StringIO(), threading.Event()
    given = [case.kind, "--channel", channel, "--drives", ",".join(map(str, numbers))]
    drives = made(arguments([*given, "--log", "-", *single, *case.left, *words]), EventLog(log))
    bus = can.Bus(interface="virtual", channel=channel, fd=case.kind == "damiao")
    thread = threading.Thread(target=serve, args=(bus, drives, ended.is_set, 1e-3), daemon=True)
    thread.start()
    try:
        with DriveLine(d, known) as line:
            yield Bench(drives, line, known, log)
    finally:
        ended.set()
        thread.join()
        bus.shutdown()
