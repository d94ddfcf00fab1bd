"""The CPU that a guest is pinned to: pinned, its system calls take half the time."""

from __future__ import annotations

import fcntl
import os
import select
from pathlib import Path
from typing import IO

_SAMPLE = 0.1  # s
_IDLE, _IOWAIT = 3, 4  # columns of /proc/stat


def idle_ticks(text: str) -> dict[int, int]:
    """CPU -> ticks it was idle, from the text of ``/proc/stat``."""
    lines = [line.split() for line in text.splitlines()]
    return {
        int(name[3:]): int(numbers[_IDLE]) + int(numbers[_IOWAIT])
        for name, *numbers in lines
        if name.startswith("cpu") and name[3:].isdigit()
    }


def by_idleness(allowed: set[int], before: dict[int, int], after: dict[int, int]) -> list[int]:
    """The allowed CPUs, the idlest between two samples first."""
    gained = {cpu: after.get(cpu, 0) - before.get(cpu, 0) for cpu in allowed}
    return sorted(allowed, key=lambda cpu: (-gained[cpu], cpu))


def choose(folder: Path) -> tuple[int, IO[str] | None]:
    """The idlest allowed CPU that no other guest of this cache `folder` is on.

    Returns it and the open file that keeps it taken; None when all are taken.
    """
    allowed = os.sched_getaffinity(0)
    stat = Path("/proc/stat")
    before = idle_ticks(stat.read_text())
    if len(allowed) > 1:
        select.select([], [], [], _SAMPLE)
    order = by_idleness(allowed, before, idle_ticks(stat.read_text()))
    for cpu in order:
        file = (folder / f"cpu-{cpu}.lock").open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            continue
        return cpu, file
    return order[0], None
