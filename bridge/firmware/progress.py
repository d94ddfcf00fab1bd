"""The progress of a process, as the kernel tells it: proc(5)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Progress:
    """The processor time of a process, s, and the states of its threads.

    `ready`: a thread runs or could run; `stopped`: all are stopped, as by SIGSTOP.
    """

    seconds: float = 0.0
    ready: bool = False
    stopped: bool = False


def progress(pid: int) -> Progress:
    """The progress of a process until now; without the file system proc, none."""
    try:
        stats = [p.read_text() for p in Path(f"/proc/{pid}/task").glob("*/stat")]
    except OSError:  # a thread has just ended, or there is no proc
        return Progress(ready=True)
    fields = [text.rpartition(")")[2].split() for text in stats]
    states = {f[0] for f in fields}
    ticks = sum(int(f[11]) + int(f[12]) for f in fields)
    seconds = ticks / os.sysconf("SC_CLK_TCK")
    return Progress(seconds, "R" in states or "D" in states, bool(states) and states <= {"T", "t"})
