"""Write the tables of ``docs/openarm-reports.md``: ``python docs/openarm_reports.py``."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "openarm-reports.md"
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from cosim.bus.drive_bus import DriveBus
from cosim.bus.host_loop import BlockingLoop, blocking_loop, fixed_rate  # noqa: E402
from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat, mean  # noqa: E402

SLOW, FAST = BusTiming(1e6), BusTiming(1e6, 5e6, fd=True)
SWITCHED, UNSWITCHED = FrameFormat(fd=True, brs=True), FrameFormat(fd=True)
#: Drives, bus, format, rate that was reported, 1/s.
RATES: tuple[tuple[int, BusTiming, FrameFormat, float], ...] = (
    (6, SLOW, CLASSIC, 1175.0),
    (7, SLOW, CLASSIC, 1000.0),
    (8, SLOW, CLASSIC, 900.0),
    (8, SLOW, CLASSIC, 950.0),
    (8, FAST, SWITCHED, 1600.0),
    (8, FAST, SWITCHED, 2000.0),
    (9, FAST, SWITCHED, 1000.0),
)
#: Latency of the adapter in each direction, s.
LATENCIES = (0.0, 50e-6, 125e-6, 160e-6)
#: What is changed in the program of openarm_ros2#82, at the period of 1 ms; arms in one thread.
CURES: tuple[tuple[str, BlockingLoop, int], ...] = (
    ("reads end when nothing is there", BlockingLoop(every_frame=False, period=1e-3), 2),
    ("no refresh frames as well", BlockingLoop(every_frame=False, ask=0.0, period=1e-3), 2),
    ("and a thread for each arm", BlockingLoop(every_frame=False, ask=0.0, period=1e-3), 1),
)


def limit(drives: int, timing: BusTiming, kind: FrameFormat) -> float:
    """The rate, 1/s, at which a command and an answer of each drive fill the bus; random bytes."""
    return 1e9 / (2 * drives * frame_ns(drives, timing, kind))


def frame_ns(drives: int, timing: BusTiming, kind: FrameFormat) -> float:
    """The mean time of a command or an answer of 8 random bytes, ns."""
    identifiers = [base + i for i in range(1, drives + 1) for base in (0, 0x10)]
    times = [timing.time_ns(mean(8, kind, identifier)) for identifier in identifiers]
    return sum(times) / len(times)


def rates() -> list[list[str]]:
    """Rows of the table of openarm#34 and #96."""
    rows = []
    for drives, timing, kind, rate in RATES:
        found = fixed_rate(DriveBus(drives, timing, kind), rate, 0.5)
        bus = "FD 1/5 Mbit/s" if kind.fd else "classic 1 Mbit/s"
        commands = rate / limit(drives, timing, kind) / 2
        rows.append(
            [str(drives), bus, f"{rate:.0f}", f"{limit(drives, timing, kind):.0f}",
             f"{commands:.0%}", f"{found.load:.1%}", f"{found.answered:.0%}"]
        )  # fmt: skip
    return rows


def loops() -> list[list[str]]:
    """Rows of the table of openarm_ros2#82: the program as it was, by the adapter's latency."""
    rows = []
    for latency in LATENCIES:
        arms = [DriveBus(8, FAST, SWITCHED, latency=latency)] * 2
        found = blocking_loop(arms, BlockingLoop())
        rows.append([f"{latency * 1e6:.0f} µs", f"{found.rate:.0f}", f"{found.load:.1%}"])
    return rows


def cures() -> list[list[str]]:
    """Rows of what removes each limit."""
    rows = []
    for name, loop, arms in CURES:
        found = blocking_loop([DriveBus(8, FAST, SWITCHED, latency=50e-6)] * arms, loop)
        rows.append([name, f"{found.rate:.0f}", f"{found.load:.1%}", f"{found.answered:.0%}"])
    return rows


def formats() -> list[list[str]]:
    """Rows of the formats that openarm_teleop#8 and lerobot#3178 are about."""
    found = (
        ("classic, 1 Mbit/s", SLOW, CLASSIC),
        ("FD without BRS, all bits at 1 Mbit/s", FAST, UNSWITCHED),
        ("FD with BRS, 1 and 5 Mbit/s", FAST, SWITCHED),
    )
    return [
        [name, f"{frame_ns(8, timing, kind) / 1e3:.1f}", f"{limit(8, timing, kind):.0f}"]
        for name, timing, kind in found
    ]


TABLES = {
    "rates": (
        ["drives", "bus", "reported [Hz]", "limit with all answers [Hz]", "commands alone", "load",
         "answers that get through"], rates,
    ),
    "loops": (["latency, each way", "rate [Hz]", "load of each bus"], loops),
    "cures": (["changed", "rate [Hz]", "load of each bus", "answers"], cures),
    "formats": (["frame of 8 bytes", "mean time [µs]", "8 drives, all answers [Hz]"], formats),
}  # fmt: skip


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def page(text: str) -> str:
    """The page with new tables."""
    for name, (head, rows) in TABLES.items():
        pattern = rf"(<!-- {name} -->\n)(?:\|.*\n)*(<!-- end -->)"
        made = table(head, rows())
        text = re.sub(pattern, lambda found, made=made: found[1] + made + found[2], text)
    return text


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
