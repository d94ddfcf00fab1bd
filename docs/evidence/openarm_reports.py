"""Write the tables of ``openarm-reports.md``: ``python docs/evidence/openarm_reports.py``."""

from __future__ import annotations

import re
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from runpy import run_path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PAGE = Path(__file__).with_name("openarm-reports.md")
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

import cosim  # noqa: E402
from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat, mean  # noqa: E402
from docs.evidence.coupled_joints import CoupledJoints  # noqa: E402
from docs.evidence.drive_bus import DriveBus  # noqa: E402
from docs.evidence.host_loop import (  # noqa: E402
    BlockingLoop,
    CommandTimes,
    bilateral_loop,
    blocking_loop,
    fixed_rate,
)

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
#: Latency of the adapter in each direction, s, and the least time between two answers, s.
LATENCIES = (0.0, 50e-6, 125e-6, 160e-6)
SPACINGS = (0.0, 110e-6, 125e-6)
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
    """Rows of the table of openarm_ros2#82: the program as it was, by the adapter."""
    rows = []
    for latency in LATENCIES:
        row = [f"{latency * 1e6:.0f} µs"]
        for spacing in SPACINGS:
            arms = [DriveBus(8, FAST, SWITCHED, latency=latency, spacing=spacing)] * 2
            found = blocking_loop(arms, BlockingLoop())
            row.append(f"{found.rate:.0f} Hz, {found.load:.1%}")
        rows.append(row)
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


STUDY = ROOT / "configs" / "studies" / "joint2.toml"
VIBRATION = ROOT / "configs" / "vibration"


def hosts() -> Iterator[tuple[CommandTimes, CommandTimes]]:
    """What joint 2 of both arms hears, for each case of the study's axis `host`, in its order."""
    written = run_path(str(VIBRATION / "write.py"))
    for bus, loop in written["CASES"].values():
        yield bilateral_loop((bus, bus), loop, written["DRIVE"], 1.2)


def held(commands: CommandTimes, taken: np.ndarray) -> tuple[float, float]:
    """Mean and greatest age, s, of the state that a drive holds."""
    lasts = np.diff(commands.heard)  # (n,), s
    mean_age = np.average(commands.heard[:-1] - taken[:-1] + lasts / 2, weights=lasts)
    return float(mean_age), float((commands.heard[1:] - taken[:-1]).max())


def ages() -> list[list[str]]:
    """Rows of how old own state and reference are."""
    rows = []
    for name, arms in zip(_study()["vary"]["host"]["cases"], hosts(), strict=True):
        row = [name]
        for part in ("own", "other"):
            found = [held(arm, getattr(arm, part)) for arm in arms]
            row.append(" / ".join(f"{1e3 * age:.1f}" for age, _ in found))
            row.append(f"{1e3 * max(most for _, most in found):.1f}")
        rows.append(row)
    return rows


def vibrations() -> list[list[str]]:
    """Rows of openarm_teleop#9: each joint and host at which something does not decay."""
    study = _study()
    with tempfile.TemporaryDirectory() as folder:
        runs = iter(cosim.sweep(STUDY, out=folder).records)
    aged = [
        [float(np.mean([held(arm, getattr(arm, part))[0] for arm in arms])) for part in _PARTS]
        for arms in hosts()
    ]
    rows = []
    for joint, settings in study["vary"]["joint"]["cases"].items():
        pair = CoupledJoints(_parameters(settings))
        for host, (other, own) in zip(study["vary"]["host"]["cases"], aged, strict=True):
            mode, cycle, run = pair.mode(other, own), pair.cycle(other, own), next(runs)
            predicted = ["decays", ""] if mode.growth < 0.0 else [f"{mode.frequency:.1f} Hz", "–"]
            if cycle is not None:
                predicted = [f"{cycle.frequency:.1f} Hz", f"{cycle.angle:.2g} rad"]
            simulated = ["decays", ""]
            if run["vibration"] > 1e-3:
                hertz, swing = run["vibration.frequency_hz"], run["vibration"]
                simulated = [f"{hertz:.1f} Hz", f"{swing:.2g} rad, {run['torque']:.2g} N·m"]
            if (predicted[0], simulated[0]) != ("decays", "decays"):
                rows.append([joint, host, f"{mode.growth:+.1f}", *predicted, *simulated])
    return rows


_PARTS = ("other", "own")


def _study() -> dict[str, Any]:
    return tomllib.loads(STUDY.read_text(encoding="utf-8"))


def _parameters(settings: Sequence[str]) -> dict[str, np.ndarray]:
    """Parameters of one joint of the scenario with these settings, (1,) each."""
    scenario = tomllib.loads((VIBRATION / "joint2.toml").read_text(encoding="utf-8"))
    values = {"k_g": 0.0, "d_g": 0.0, "M_s": 1.0, "k_s": 0.0, "d_s": 0.0}
    values |= scenario["components"]["leader"]["parameters"]
    start = "components.leader.parameters."
    for setting in settings:
        path, _, value = setting.partition("=")
        if path.startswith(start):
            values[path.removeprefix(start)] = float(value)
    return {name: np.array([value]) for name, value in values.items()}


TABLES = {
    "rates": (
        ["drives", "bus", "reported [Hz]", "limit with all answers [Hz]", "commands alone", "load",
         "answers that get through"], rates,
    ),
    "loops": (
        ["latency, each way", "answers as they come", *(
            f"{spacing * 1e6:.0f} µs apart" for spacing in SPACINGS[1:])], loops,
    ),
    "cures": (["changed", "rate [Hz]", "load of each bus", "answers"], cures),
    "ages": (
        ["host", "own state: mean [ms]", "greatest", "other's state: mean [ms]", "greatest"], ages,
    ),
    "vibrations": (
        ["joint", "host", "growth [1/s]", "predicted", "amplitude", "simulated", "amplitude"],
        vibrations,
    ),
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
