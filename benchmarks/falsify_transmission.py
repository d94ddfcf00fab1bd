"""The search of ``cosim falsify`` on a published benchmark: the transmission of ARCH-COMP.

    python -m benchmarks.falsify_transmission [--quick] [--seeds N] [--runs N] [--jobs N]
                                              [--json FILE]

The inputs, throttle (0 to 100 %) and brake (0 to 325 ft lb), take the place of the delays: any
signals within their bounds, constant in steps of 0.02 s (instance 1 of the competition). The
formulas are those of `Autotrans_shift` in the competition's list of requirements. A run ends where
its formula can be judged. *all* are the families in the product's order, without those that need
links (draw, greedy); the first runs are constant inputs.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: threads of BLAS would be measured

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from time import process_time
from typing import Any

import numpy as np

from benchmarks import tables
from benchmarks.falsify_families import all_measured, arguments, failures_within
from benchmarks.transmission import STEP, simulate
from cosim.falsify.bounds import MovingChannel
from cosim.falsify.evaluation import Problem
from cosim.falsify.judge import CandidateOutcome, margin
from cosim.falsify.paths import Candidate
from cosim.links.laws import FloatArray
from cosim.measure.requirements import Requirement, requirements
from cosim.record import Column
from cosim.scenario.spec import build
from cosim.study.memory import Memory

COLUMNS = (Column("speed", "1", 0), Column("rpm", "rpm", 1), Column("gear", "1", 2))
#: The greatest throttle (%) and brake (ft lb), and those of the nominal run.
THROTTLE, BRAKE, NOMINAL = 100.0, 325.0, (50.0, 0.0)


def _stays(gear: int) -> str:
    """AT51 to AT54: a gear that is engaged stays for 2.5 s."""
    here = f"({gear - 0.5} <= gear <= {gear + 0.5})"
    soon = "eventually within [0.001 s, 0.1 s]"
    return (
        f"always within [0 s, 30 s] ((not {here} and {soon} {here}) implies "
        f"{soon} (always within [0 s, 2.5 s] {here}))"
    )


def _slow(time: int, speed: int) -> str:
    """AT6a to AT6c: whoever keeps the engine slow stays slow for a time (s), in mph."""
    return (
        "always within [0 s, 30 s] (rpm < 3000 rpm) implies "
        f"always within [0 s, {time} s] (speed < {speed})"
    )


#: The formulas, and the length of a run that decides them, s.
FORMULAS = {
    "AT1": ("always within [0 s, 20 s] (speed < 120)", 20.0),
    "AT2": ("always within [0 s, 10 s] (rpm < 4750 rpm)", 10.0),
    **{f"AT5{gear}": (_stays(gear), 32.6) for gear in (1, 2, 3, 4)},
    **{f"AT6{x}": (_slow(t, v), 30.0) for x, t, v in (("a", 4, 35), ("b", 8, 50), ("c", 20, 65))},
}
#: The families that are searched, by the name of the column.
SEARCHES = {
    "all": ("constant", "wave", "segment", "single", "optimizer"),
    "segment, single, optimizer": ("segment", "single", "optimizer"),
}


@dataclass(frozen=True, slots=True)
class Transmission:
    """The transmission with one of :data:`FORMULAS`, as a search sees it."""

    formula: str

    @property
    def problem(self) -> Problem:
        """Two signals that may be anything within their bounds."""
        ticks = round(FORMULAS[self.formula][1] / STEP)
        found = [
            MovingChannel(name, (), (), 1, STEP, 0.0, high, nominal)
            for name, high, nominal in zip(
                ("throttle", "brake"), (THROTTLE, BRAKE), NOMINAL, strict=True
            )
        ]
        return Problem(
            Path("transmission"), {}, tuple(found), (), (self.formula,), ticks, STEP,
            self.formula, (), (),
        )  # fmt: skip

    @property
    def requirement(self) -> Requirement:
        """The formula, ready to be evaluated."""
        problem = self.problem
        document = {
            "run": {"step": STEP, "stop": problem.ticks * STEP},
            "components": {},
            "require": {self.formula: {"formula": FORMULAS[self.formula][0]}},
        }
        scenario = build(document, problem.path)
        return requirements(scenario, {c.name: c.unit for c in COLUMNS})[0]

    def evaluate(self, candidates: Sequence[Candidate]) -> list[CandidateOutcome]:
        """Run candidates together, and judge them by the formula."""
        problem, requirement = self.problem, self.requirement
        at = np.arange(problem.ticks)
        paths = [problem.kept(candidate) for candidate in candidates]
        throttle, brake = (np.array([p[i].at(at) for p in paths]).T for i in (0, 1))
        found = np.stack(simulate(throttle, brake))
        t: FloatArray = np.array(STEP * np.arange(problem.ticks + 1), np.float64)
        return [
            CandidateOutcome(
                one.key, {self.formula: margin(requirement, Memory(COLUMNS, t, found[:, :, i]))}
            )
            for i, one in enumerate(candidates)
        ]


def measured(formula: str, search: str, seeds: int, runs: int) -> dict[str, Any]:
    """The first failures of all seeds, and the processor time, s."""
    before, plant = process_time(), Transmission(formula)
    first = failures_within(plant.problem, seeds, plant.evaluate, SEARCHES[search], runs)
    seconds = process_time() - before
    return {"formula": formula, "search": search, "first": first, "seconds": seconds}


def cell(first: Sequence[int | None], short: int) -> str:
    """Mean and median of the runs that were needed, and how many seeds found one, and how soon."""
    found = [x for x in first if x is not None]
    soon = sum(x <= short for x in found)
    if not found:
        return f"— (0 of {len(first)})"
    return f"{fmean(found):.1f} / {median(found):g} ({soon}, {len(found)} of {len(first)})"


def main() -> None:
    """Measure, and print the table."""
    parser = arguments(__doc__, 1500)
    parser.add_argument("--short", type=int, default=300, help="a shorter budget, counted too")
    options = parser.parse_args()
    tasks = [(formula, search) for formula in FORMULAS for search in SEARCHES]
    found = all_measured(options, 20, measured, tasks)
    cells = {(x["formula"], x["search"]): cell(x["first"], options.short) for x in found}
    rows = [[formula, *(cells[formula, search] for search in SEARCHES)] for formula in FORMULAS]
    print(tables.grid(["formula", *SEARCHES], rows))
    seconds = sum(x["seconds"] for x in found)
    print(f"\nmean / median of runs (found in {options.short}, in {options.runs} runs)")
    print(f"{seconds:.0f} s of processor time")


if __name__ == "__main__":
    main()
