"""Interleaved timing: each candidate runs a block, then each runs the next block.

Other load of the machine therefore affects all alike. Results are compared before the timing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Protocol

from benchmarks.peers import Absent, silence


class Session(Protocol):
    """One master on one case, from the start on."""

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""

    def outputs(self) -> bytes:
        """All outputs as they are; empty where they cannot be had."""

    def recorded(self, n: int) -> bytes:
        """The first `n` rows of all signals since the last `run`, if they are kept like that."""

    def close(self) -> None:
        """Free everything."""


@dataclass(frozen=True, slots=True)
class Contestant:
    """`share`: of the ticks of a block; `blocks`: in each round; `floor`: what it is divided by."""

    label: str
    make: Callable[[], Session]
    floor: str
    share: float = 1.0
    blocks: int = 1


@dataclass(slots=True)
class Timing:
    """Of one contestant: µs per FMU step, one number a block; whether it computes the same."""

    label: str
    us: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    best_ratio: float = 0.0
    same: bool | None = None
    absent: str = ""

    def facts(self) -> dict[str, Any]:
        """For the table and the JSON file: µs, and ratios to the floor."""
        if not self.us:
            return {"runner": self.label, "absent": self.absent}
        ordered = sorted(self.us)
        quarter = len(ordered) // 4
        return {
            "runner": self.label,
            "min_us": ordered[0],
            "median_us": median(ordered),
            "spread": (ordered[-1 - quarter] - ordered[quarter]) / median(ordered),
            "blocks": len(ordered),
            "ratio_min": self.best_ratio,
            "ratio_median": median(self.ratios),
            "same": self.same,
        }


def race(
    contestants: Sequence[Contestant], *, ticks: int, fmu_steps: float, rounds: int, check: int
) -> list[Timing]:
    """Time blocks of `ticks` ticks; `check` ticks at the start are compared and not timed.

    The first contestant is the floor the others must agree with.
    """
    timings = {c.label: Timing(c.label) for c in contestants}
    sessions: dict[str, Session] = {}
    try:
        for c in contestants:
            try:
                with silence():
                    sessions[c.label] = c.make()
            except Absent as absent:
                timings[c.label].absent = str(absent)
        _compare(contestants, sessions, timings, check)
        for _ in range(rounds):
            for block in range(max(c.blocks for c in contestants)):
                for c in contestants:
                    if block < c.blocks and c.label in sessions:
                        n = max(10, round(ticks * c.share))
                        seconds = _block(sessions, timings[c.label], n)
                        timings[c.label].us.append(seconds / n / fmu_steps * 1e6)
    finally:
        with silence():
            for session in sessions.values():
                session.close()
    for c in contestants:
        if timings[c.label].absent:
            timings[c.label].us.clear()
        else:
            _relate(timings[c.label], timings[c.floor])
    return list(timings.values())


def _block(sessions: dict[str, Session], timing: Timing, ticks: int) -> float:
    """Seconds of one block; who fails in it is out, with the reason."""
    try:
        return sessions[timing.label].run(ticks)
    except Absent as absent:
        timing.absent = str(absent)
        sessions.pop(timing.label).close()
        return float("nan")


def _compare(
    contestants: Sequence[Contestant],
    sessions: dict[str, Session],
    timings: dict[str, Timing],
    check: int,
) -> None:
    expected, rows = b"", b""
    for c in contestants:
        if c.label not in sessions:
            continue
        session, timing = sessions[c.label], timings[c.label]
        _block(sessions, timing, check)
        if c.label not in sessions:
            continue
        found, kept = session.outputs(), session.recorded(check)
        expected, rows = expected or found, rows or kept
        if found:
            timing.same = found == expected and (not kept or kept == rows)


def _relate(timing: Timing, floor: Timing) -> None:
    """Ratios of a block to the floor's block next to it, and of the best to the best."""
    n, m = len(timing.us), len(floor.us)
    timing.ratios = [us / floor.us[i * m // n] for i, us in enumerate(timing.us)]
    timing.best_ratio = min(timing.us) / min(floor.us)
