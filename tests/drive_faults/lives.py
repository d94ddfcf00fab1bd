"""One run of the campaign: a whole life of all nodes with one fault of a drive, and its judgement.

All nodes get ARM and START, run, get STOP, then RESET, ARM and START, and run to the end. The fault
begins at any time of that. A run is made by its seed alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bridge.campaign import compressed
from bridge.campaign.drive_draw import draw_drive_fault, drives_of
from bridge.campaign.drive_judge import JudgedDrive, judge_drives
from bridge.deployment.system import System
from bridge.faults.load import build
from bridge.native.safety import Command, LifeState
from bridge.records.node_lives import Life
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.verdict import Word
from cosim.record.folder import read_metadata
from tests.bridge.deployments import named

DEPLOYMENTS = ("can-damiao", "openarm", "six_axis", "can-cia402", "can")
#: s: ARM and START, STOP, RESET with ARM and START, the end.
BEGIN, STOP, AGAIN, END = 0.1, 1.0, 1.3, 2.4
COMMANDS = (
    (round(BEGIN * 1e9), (Command.ARM, Command.START)),
    (round(STOP * 1e9), (Command.STOP,)),
    (round(AGAIN * 1e9), (Command.RESET, Command.ARM, Command.START)),
)
#: s from the moment in which a drive is off to the first slot that is not ACTIVE, at most. Damiao
#: and CiA 402: what is told is obeyed in the next slot, silence for 0.1 s; ODrive: heartbeats
#: come every 0.1 s, silence lasts 0.35 s.
BOUNDS = {"damiao": 0.12, "cia402": 0.12, "odrive": 0.37, "ours": 0.22}


@dataclass(frozen=True)
class Row:
    """The outcome of a run; `problems`: the rules that it breaks, if any."""

    seed: int
    deployment: str
    vendor: str
    drive: str
    does: str
    code: int
    at: float
    lasts: float | None
    phase: str
    torques: int
    forbidden: int
    unheard: int
    off: float
    stopped: float | None
    verdict: str
    reasons: str
    evidence: str
    exact: bool
    problems: list[str] = field(default_factory=list)

    def facts(self) -> dict[str, Any]:
        """The outcome as plain data."""
        return asdict(self)


@lru_cache(maxsize=len(DEPLOYMENTS))
def system_of(deployment: str) -> System:
    """A deployment, loaded once: runs initialize its components anew."""
    return named(deployment, f"run.stop={END}")


def table_of(system: System, seed: int) -> dict[str, Any]:
    """The fault of a run."""
    random = np.random.default_rng(seed)
    table = draw_drive_fault(drives_of(system), random, 0.0, END)
    if table["does"] == "drop":  # it acts where a drive is enabled
        first, last = (0.0, BEGIN) if random.random() < 0.5 else (STOP, AGAIN)
        table["at"] = round(float(random.uniform(first, last)), 4)
    return table


def run(seed: int, folder: Path, table: dict[str, Any] | None = None) -> Row:
    """Make and judge the run of a seed; `table`: another fault than the one that is drawn."""
    deployment = DEPLOYMENTS[seed % len(DEPLOYMENTS)]
    system = system_of(deployment)
    table = table or table_of(system, seed)
    script = build({"seed": seed, "fault": [table]}, Path("drive.toml"))
    outcome = compressed.run(system, script, folder, commands=COMMANDS)
    judged = list(judge_drives(system, script, folder / "nodes", cold=True))
    name = f"drive {table['drive']} on bus {table['bus']}"
    mine = next(one for one in judged if one.name == name)
    said = read_metadata(folder)["rehearsal"]  # the verdict of the run's own folder
    active = list(_active(system, outcome, mine))
    (evidence,) = outcome.faults
    stops = list(_stops(mine, active))
    exact = outcome.replayed is not None and outcome.replayed.first is None
    row = Row(
        seed, deployment, mine.vendor, name, table["does"], table.get("code", 0), table["at"],
        table.get("for"), _phase(system, outcome, mine, table["at"]),
        sum(one.torques for one in judged), sum(len(one.forbidden) for one in judged),
        sum(one.unheard for one in judged), _overlap(mine, active), max(stops, default=None),
        said["verdict"], "; ".join(said["reasons"]), evidence.text(), exact,
    )  # fmt: skip
    row.problems.extend(_problems(row, judged))
    return row


def _problems(row: Row, judged: Sequence[JudgedDrive]) -> Iterator[str]:
    for one in judged:
        if one.forbidden:
            first = f"first at {one.forbidden[0]:.4f} s"
            yield f"{len(one.forbidden)} torques to {one.name}, which was not enabled, {first}"
    if not row.exact:
        yield "the replay is not the run"
    if row.off > 0 and row.verdict == Word.PASSED:
        yield f"passed, with a drive off for {row.off:.3f} s of the run"
    if row.off > 0 and row.drive not in f"{row.reasons}":
        yield f"the verdict does not name the drive: {row.reasons}"
    if row.stopped is not None and row.stopped > BOUNDS[row.vendor]:
        yield f"stopped {row.stopped:.3f} s after the drive was off"


def _states(system: System, outcome: RehearsalOutcome, one: JudgedDrive) -> Iterator[Any]:
    """(state, from, to) of the node that commands a drive, s."""
    rows, h = outcome.rows[Life(one.host)], system.nodes[one.host].h
    phase = float(rows["deadline_ns"][0]) * 1e-9 - float(rows["slot"][0]) * h
    edges = np.flatnonzero(np.diff(rows["state"])) + 1
    for a, b in zip([0, *edges], [*edges, len(rows)], strict=True):
        t0 = float(rows["slot"][a]) * h + phase
        yield LifeState(int(rows["state"][a])), t0, t0 + (b - a) * h


def _active(
    system: System, outcome: RehearsalOutcome, one: JudgedDrive
) -> Iterator[tuple[float, float]]:
    for state, a, b in _states(system, outcome, one):
        if state is LifeState.ACTIVE:
            yield a, b


def _phase(system: System, outcome: RehearsalOutcome, one: JudgedDrive, t: float) -> str:
    for state, a, b in _states(system, outcome, one):
        if a <= t < b:
            if state is not LifeState.INACTIVE:
                return {LifeState.ACTIVE: "run", LifeState.STOPPING: "ramp"}.get(state, "fault")
            return "off" if t < BEGIN or STOP <= t < AGAIN else "bring-up"
    return "off" if t < BEGIN else "end"


def _overlap(one: JudgedDrive, active: Sequence[tuple[float, float]]) -> float:
    """s for which the drive was off while its node was ACTIVE."""
    return sum(max(0.0, min(b, d) - max(a, c)) for a, b in one.off for c, d in active)


def _stops(one: JudgedDrive, active: Sequence[tuple[float, float]]) -> Iterator[float]:
    """s from each time at which the drive was off in the run, until its node was not ACTIVE."""
    yield from (d - max(a, c) for a, b in one.off for c, d in active if max(a, c) < min(b, d))
