"""``python -m tests.drive_faults.waits``: faults of drives before t = 0, on the wall clock.

A node is armed, brings its drives up, gets START and begins, all in real time; its drives are in C,
as their vendors describe them, on memory rings. The fault begins before ARM, in the bring-up, when
all are ready, or between START and t = 0. A seed makes a run; its times are those of the machine.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np

from bridge.campaign import drive_judge
from bridge.campaign.drive_draw import draw_drive_fault, drives_of
from bridge.faults.load import build
from bridge.faults.script import DriveFault
from bridge.native.frame import Flags, Frame, Ring, frame_dtype
from bridge.native.safety import LifeState
from cosim.base.clock import monotonic_ns
from cosim.base.copies import replace
from cosim.cli.show import aligned
from tests.bridge.deployments import named
from tests.bridge.node.motors import Motors
from tests.bridge.node.test_bringup import gate, ready

DEPLOYMENTS = {"can-damiao": 0, "can-cia402": 2, "openarm": 0, "six_axis": 0}
PHASES = ("rest", "rise", "serve", "stand")
#: s: the longest time of a fault into its phase; from START to t = 0; a run after it; for anything.
INTO, LEAD, AFTER, PATIENCE = 0.2, 0.25, 0.1, 20.0
#: s: what is silent for longer is off, here: a busy machine lets drives wait. And to notice it.
SILENT, BOUND = 1.0, 2.5
#: s: of the drives here; and the identifier of the registers of Damiao drives.
WATCHDOG, REGISTERS = 5.0, 0x7FF


@dataclass(frozen=True)
class Waited:
    """The outcome of a run; `problems`: the rules that it breaks, if any."""

    seed: int
    deployment: str
    drive: str
    does: str
    code: int
    at: float
    lasts: float | None
    phase: str
    end: str
    off: bool
    early: int
    forbidden: int
    text: str
    problems: list[str] = field(default_factory=list)

    def facts(self) -> dict[str, Any]:
        """The outcome as plain data."""
        return asdict(self)


class Recorder:
    """A ring to a node, and what was put into it."""

    def __init__(self, ring: Ring) -> None:
        self.ring: Ring = ring
        self.frames: list[Frame] = []

    def put(self, frame: Frame) -> None:
        """Into the ring."""
        self.frames.append(Frame.from_buffer_copy(frame))
        self.ring.put(frame)


class Sufferer:
    """The drive with the faults, which begin and end while the test waits."""

    def __init__(self, motors: Motors, events: Sequence[DriveFault]) -> None:
        bus, number = events[0].bus, events[0].drive
        self.motors, self.left = motors, list(events)
        self.begun_ns, self.happened = 0, []
        self.index = next(
            i for i, (d, _) in enumerate(motors.motors) if (d.bus, d.node) == (bus, number)
        )

    @property
    def own(self) -> Any:
        return self.motors[self.index]

    def begin(self) -> None:
        """The fault begins now."""
        self.begun_ns = monotonic_ns()
        self.happen()

    def happen(self) -> None:
        """All that is due by now."""
        now = monotonic_ns()
        while self.begun_ns and self.left and now >= self.begun_ns + round(self.left[0].t * 1e9):
            one = self.left.pop(0)
            self.motors.fault(self.index, one.fault, one.code)
            self.happened.append(replace(one, t=now * 1e-9))

    def wait(self, true: Callable[[], bool], seconds: float = PATIENCE) -> bool:
        """Until something is true; False: it is not in time."""
        end = time.monotonic() + seconds
        while not true():
            if time.monotonic() > end:
                return False
            self.happen()
            time.sleep(0.001)
        return True


def table_of(seed: int) -> tuple[str, str, float, dict[str, Any]]:
    """The deployment, the phase, the time into it (s) and the fault of a run."""
    random = np.random.default_rng(seed)
    deployment = list(DEPLOYMENTS)[seed % len(DEPLOYMENTS)]
    drives = [d for d in drives_of(named(deployment)) if d.bus == "left"]
    table = draw_drive_fault(drives, random, 0.0, 0.5)
    table["at"] = 0.0
    return deployment, str(random.choice(PHASES)), float(random.uniform(0, INTO)), table


def run(seed: int, folder: Path) -> Waited:
    """Make and judge the run of a seed."""
    deployment, phase, at, table = table_of(seed)
    script = build({"seed": seed, "fault": [table]}, Path("drive.toml"))
    with gate(deployment, folder) as node:
        _relax(node)
        rings = {bus: (Recorder(rx), tx) for bus, (rx, tx) in node.rings.items()}
        beside = SimpleNamespace(rings=rings, wired=node.wired)
        motors = Motors(beside, DEPLOYMENTS[deployment], timeout=WATCHDOG)
        for drive, own in motors.motors:
            own.format = int(drive.profile.format & (Flags.FD | Flags.BRS))
        with motors:
            one = Sufferer(motors, script.drives)
            _live(node, one, phase, at)
            end = "started" if node.struct.begun else "refused"
            start = int(node.struct.start_ns) if node.struct.begun else monotonic_ns()
            if end == "started":
                one.wait(lambda: node.struct.life.state == LifeState.FAULT, AFTER)
                if not one.own.acts:
                    one.wait(lambda: node.struct.life.state == LifeState.FAULT, BOUND)
            off = not one.own.acts
            stopped = node.struct.life.state == LifeState.FAULT
            text = "; ".join((*node.wired.commanded.given_up(), *node.wired.commanded.not_ready()))
            if stopped:  # a cable that is back in, or a drive that woke up, is told again
                one.wait(lambda: not one.left)
                one.wait(lambda: not any(own.acts for _, own in motors.motors), 1.0)
            node.control.quit()
            one.wait(lambda: node.result is not None)
            one.wait(lambda: not any(own.acts for _, own in motors.motors), 0.5)
            slots = node.wired.journal.rows[["woke_ns", "deadline_ns"]].copy()
            left_on = [d.name for d, own in motors.motors if own.acts and own.plugged]
    drive = motors.motors[one.index][0]
    told = {bus: rx.frames for bus, (rx, _) in rings.items()}
    early, forbidden = _judged(start, told, motors, one, slots)
    found = Waited(
        seed, deployment, drive.name, table["does"], table.get("code", 0), round(at, 4),
        table.get("for"), phase, "stopped" if end == "started" and stopped else end, off,
        early, forbidden, text,
    )  # fmt: skip
    found.problems.extend(_problems(found, drive.node, left_on))
    return found


def _relax(node: Any) -> None:
    """Let the node write a longer TIMEOUT into Damiao drives: a busy machine starves them."""
    ticks = round(WATCHDOG / 50e-6)
    for drive in node.wired.commanded.structs:
        for step in drive.steps[: drive.n_steps]:
            if step.frame.id == REGISTERS:
                step.frame.data[4:8] = list(ticks.to_bytes(4, "little"))
                step.value = step.value & 0xFFFFFFFF | ticks << 32


def _live(node: Any, one: Sufferer, phase: str, at: float) -> None:
    """ARM, START and t = 0, with the fault in its phase."""
    failed = lambda: node.struct.life.state == LifeState.FAULT  # noqa: E731
    if phase == "rest":
        one.begin()
        one.wait(lambda: False, at)
    node.control.arm()
    if phase == "rise":
        one.wait(lambda: False, at * 0.2)
        one.begin()
    one.wait(lambda: ready(node) or failed(), 5.0)
    if phase == "serve":
        one.begin()
        one.wait(failed, at)
    node.control.start(monotonic_ns() + round(LEAD * 1e9))
    if phase == "stand":
        one.wait(failed, at)
        one.begin()
    one.wait(lambda: node.struct.begun or node.struct.refusals or failed())


def _judged(
    start: int, told: Mapping[str, Sequence[Frame]], motors: Motors, one: Sufferer, slots: Any
) -> tuple[int, int]:
    """Torques before t = 0; torques to drives that had told that they are off.

    A slot reads what came until its time: torques of late ones could not know what was told later.
    """
    early = forbidden = 0
    for drive, own in motors.motors:
        reading = drive_judge.READINGS[drive.profile.vendor]
        reading = replace(reading, silent=round((SILENT + 0.5) * 1e9))
        log = _log(motors.sent[drive.bus], told[drive.bus], drive, reading)
        torque = (log["flags"] & Flags.SENT != 0) & (log["id"] == reading.torque(drive.node))
        times = drive_judge._times(log, torque, reading.nonzero)
        early += int(np.count_nonzero(times < start))
        faults = one.happened if own is one.own else []
        _, bad, _, _ = drive_judge._judged(drive.node, WATCHDOG, reading, log, faults, True)
        times, on = drive_judge._told(
            log, log["flags"] & Flags.SENT != 0, drive.node, reading, True
        )
        for t in np.round(np.array(bad) * 1e9).astype(np.int64):
            newest = np.searchsorted(times, t, side="right") - 1
            slot = np.searchsorted(slots["woke_ns"] + start, t, side="right") - 1
            knew = slot < 0 or slots["deadline_ns"][slot] + start > times[newest]
            forbidden += bool(knew or on[newest])
    return early, forbidden


def _log(
    sent: Sequence[Frame], told: Sequence[Frame], drive: Any, reading: drive_judge.Reading
) -> Any:
    """The frames that a node sent to a drive and got from it, in the form of the node's log."""
    frames = [*((f, Flags.SENT) for f in sent), *((f, 0) for f in told)]
    own = {reading.torque(drive.node), reading.state(drive.node), *reading.requests(drive.node)}
    chosen = sorted(((f, s) for f, s in frames if f.id in own), key=lambda entry: entry[0].t_ns)
    log = np.zeros(len(chosen), frame_dtype(64))
    for row, (frame, kind) in zip(log, chosen, strict=True):
        data = frame.payload
        row["t_ns"], row["id"], row["length"] = frame.t_ns, frame.id, len(data)
        row["flags"] = kind
        row["data"][: len(data)] = list(data)
    return log


def _names(text: str, number: int) -> bool:
    return re.search(rf"\b(0x)?{number:x}\b|\b{number}\b", text) is not None


def _problems(row: Waited, number: int, left_on: Sequence[str]) -> Iterator[str]:
    if row.early:
        yield f"{row.early} torques before t = 0"
    if row.forbidden:
        yield f"{row.forbidden} torques to drives that had told that they are off"
    if row.off and row.end == "started":
        yield "it runs on with a drive off"
    named = [number, number + 1] if row.does == "other-id" else [number]
    if row.end != "started" and not any(_names(row.text, n) for n in named):
        yield f"the node does not name the drive: {row.text or 'nothing'}"
    if left_on:
        yield f"still enabled at the end: {', '.join(left_on)}"


def table(rows: Sequence[Waited]) -> list[list[str]]:
    """A row for each kind of drive, and one for all."""
    head = ["drives", "runs", *PHASES, "started", "refused", "stopped", "torques before t = 0"]
    found = [[*head, "to a drive that told it was off", "left on"]]
    for kind in [*DEPLOYMENTS, "all"]:
        mine = [r for r in rows if kind in ("all", r.deployment)]
        phases = [sum(r.phase == phase for r in mine) for phase in PHASES]
        ends = [sum(r.end == end for r in mine) for end in ("started", "refused", "stopped")]
        early, forbidden = (sum(getattr(r, name) for r in mine) for name in ("early", "forbidden"))
        left = sum("still enabled" in text for r in mine for text in r.problems)
        found.append([kind, *map(str, (len(mine), *phases, *ends, early, forbidden, left))])
    return found


def main(arguments: Sequence[str]) -> int:
    """Make the runs, print their table, and name those that were not as they have to be."""
    parser = argparse.ArgumentParser(prog="python -m tests.drive_faults.waits")
    parser.add_argument("--runs", type=int, default=200, help="number of runs, each with one fault")
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--out", type=Path, default=Path("runs/drive-waits.jsonl"))
    given = parser.parse_args(arguments)
    given.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    with given.out.open("w", encoding="utf-8") as file:
        for seed in range(given.first, given.first + given.runs):
            with TemporaryDirectory() as folder:
                rows.append(run(seed, Path(folder)))
            file.write(json.dumps(rows[-1].facts()) + "\n")
            file.flush()
    print("\n".join(aligned(table(rows))))
    wrong = [row for row in rows if row.problems]
    for row in wrong:
        what = f"{row.deployment}, {row.drive}: {row.does} {row.code:#x}, {row.phase}"
        print(f"seed {row.seed} ({what}): {'; '.join(row.problems)}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
