"""Write the traces of ``joint2.toml``: ``python configs/vibration/write.py``.

How old the states are that a drive gets, by a simulation of the program's threads and of both buses
(:func:`docs.evidence.host_loop.bilateral_loop`), as traces of the delay of each sample that
reached it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.bus.settings import QueueKind
from cosim.bus.timing import BusTiming
from cosim.links.traces import write_trace

if (ROOT := str(Path(__file__).resolve().parents[2])) not in sys.path:
    sys.path.insert(0, ROOT)

from docs.evidence.drive_bus import DriveBus
from docs.evidence.host_loop import BilateralLoop, CommandTimes, bilateral_loop

FOLDER = Path(__file__).parent / "traces"
#: The drive of joint 2; base step of the scenario, s; begin and duration of a trace, s.
DRIVE, STEP, BEGIN, LASTS = 2, 1e-4, 0.1, 1.0
#: A socket that keeps the order of the writes and drops what exceeds 16 frames.
CLASSIC = DriveBus(8, BusTiming(1e6), latency=20e-6, queue=QueueKind.FIFO, queue_length=16)
#: Bus and threads by the name of the folder.
CASES: dict[str, tuple[DriveBus, BilateralLoop]] = {
    "classic": (CLASSIC, BilateralLoop()),
    "adapter-4ms": (replace(CLASSIC, latency=4e-3), BilateralLoop()),
    "adapter-6ms": (replace(CLASSIC, latency=6e-3), BilateralLoop()),
    "adapter-8ms": (replace(CLASSIC, latency=8e-3), BilateralLoop()),
    "stalls": (CLASSIC, BilateralLoop(stalls=20.0)),
}


def main() -> None:
    """Simulate all cases and write two traces for each arm."""
    for name, (bus, loop) in CASES.items():
        (FOLDER / name).mkdir(parents=True, exist_ok=True)
        arms = bilateral_loop((bus, bus), loop, DRIVE, BEGIN + LASTS + 0.05)
        for arm, commands in zip(("leader", "follower"), arms, strict=True):
            for part in ("own", "other"):
                sent, delay = trace(commands, getattr(commands, part))
                write_trace(FOLDER / name / f"{arm}-{part}.csv", sent, delay)


def trace(
    commands: CommandTimes, taken: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows (n,), s: when a sample was taken, and its delay; a sample that is never used is lost."""
    ticks = np.floor((taken - BEGIN) / STEP + 1e-6).astype(np.int64)
    count = round(LASTS / STEP)
    delay = np.full(count, np.nan)
    for tick, arrived in sorted(zip(ticks, commands.heard - BEGIN, strict=True), reverse=True):
        if 0 <= tick < count:
            delay[tick] = arrived - tick * STEP
    changes = np.ones(count, dtype=np.bool_)
    changes[1:] = ~(np.isnan(delay[1:]) & np.isnan(delay[:-1]))
    changes[-1] = True
    rows = np.flatnonzero(changes)
    return rows * STEP, delay[rows]


if __name__ == "__main__":
    main()
