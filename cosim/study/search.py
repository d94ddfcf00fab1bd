"""The search for a boundary: points where it may be, found round by round with ``adaptive``.

Axes that are drawn span a box, mapped to the unit cube. A run is inside the boundary if it is
stable, or if a measure is at most `level`; the learner of ``adaptive`` triangulates the points so
far and asks for points where corners of a simplex are on both sides and far from each other. So
points gather along the boundary, whatever its form. A round has a fixed number of points, which are
told in the order in which they were asked for: they do not depend on the number of workers, and
an interrupted search is repeated from the rows that are there.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import isfinite
from typing import Any, final

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.study.axes import Choice, Drawn, Listed
from cosim.study.design import Point, point
from cosim.study.run_point import StudyRow
from cosim.study.spec import BoundarySpec
from cosim.study.study import SEED, Study
from cosim.study.tasks import Tasks

#: Share of the interest in a simplex whose corners are all on one side: other parts of the boundary
#: may be in it.
ELSEWHERE = 0.02


def side(spec: BoundarySpec, *, stable: bool, failed: bool, measure: float | None) -> float:
    """The place of a run: from -1, inside, to 1, beyond the boundary, which is at 0.

    For a measure, its distance from the level, as a share of it.
    """
    if spec.of == "stable" or failed:
        return -1.0 if stable else 1.0
    if measure is None or not isfinite(measure):
        return 1.0
    return float(np.clip(measure / spec.level - 1.0, -1.0, 1.0))


def record_side(spec: BoundarySpec, record: Mapping[str, Any]) -> float:
    """The same number (without a unit) of a row of the table."""
    failed = bool(record["reason"])
    measure = None if spec.of == "stable" else record.get(spec.of)
    return side(spec, stable=bool(record["stable"]), failed=failed, measure=measure)


def _interest(simplex: Sequence[Any], values: Sequence[float], *_: Any) -> float:
    """The size of the longest edge of a simplex (corners, axes) from one side to the other.

    If there is none, a share of its volume. (The volume of one that crosses the boundary says
    little: it may be long and thin.)
    """
    corners, inside = np.asarray(simplex, dtype=np.float64), np.asarray(values) < 0.0
    if inside.all() or not inside.any():
        return ELSEWHERE * abs(float(np.linalg.det(corners[1:] - corners[0])))
    apart = corners[inside][:, None] - corners[~inside]
    longest = float(np.sqrt((apart**2).sum(axis=2).max()))
    return float(longest ** corners.shape[1])


def _interest_1(xs: Sequence[float], values: Sequence[float]) -> float:
    return _interest([[x] for x in xs], values)


def _learner(dimensions: int) -> Any:
    """A learner on the unit cube. Raises ScenarioError without ``adaptive``."""
    try:
        adaptive: Any = importlib.import_module("adaptive")
    except ImportError:
        raise ScenarioError(
            "[boundary] needs adaptive: pip install 'cosim-bridge[adaptive]'"
        ) from None
    if dimensions == 1:
        return adaptive.Learner1D(None, (0.0, 1.0), loss_per_interval=_interest_1)
    box = [(0.0, 1.0)] * dimensions
    return adaptive.LearnerND(None, box, _interest, triangulation_backend="python")


@dataclass(slots=True)
class _Asked:
    """A point of a learner: `at`, and its runs, one a seed."""

    learner: Any
    at: Any
    runs: Sequence[Point]


@final
class Search(Tasks):
    """The points of a study with a boundary, in tasks; empty while results are awaited.

    `known`: the side of each run that is there already. `found`: runs of the search that were.
    `asked`: all its points so far.
    """

    def __init__(
        self, study: Study, fingerprint: str, known: Mapping[str, float], limit: int | None
    ) -> None:
        super().__init__((), 0)
        assert study.boundary is not None
        self._spec, self._study, self._fingerprint = study.boundary, study, fingerprint
        self._sides, self._there = dict(known), frozenset(known)
        self._drawn = [axis for axis in study.axes if isinstance(axis, Drawn)]
        self._groups = [(chosen, _learner(len(self._drawn))) for chosen in listed_choices(study)]
        self._rounds = -(-self._spec.runs // self._spec.batch)
        self._round: list[_Asked] = []
        self._queue: list[Point] = []
        self.found, self.asked = 0, list[Point]()
        self.total = self._spec.runs * len(self._groups) * len(seeds(study))
        self._may = self.total if limit is None else limit
        self._advance()
        self.left = min(self._may, self.total - self.found)

    def note(self, row: StudyRow) -> None:
        """Take the result of a run."""
        measure = row.measures.get(self._spec.of)
        self._sides[row.run] = side(
            self._spec, stable=row.stable, failed=bool(row.reason), measure=measure
        )

    def __next__(self) -> Sequence[Point]:
        self._advance()
        if not self._queue:
            if not self._round or self._may <= 0:
                raise StopIteration
            return ()  # until all results of this round are there
        size = max(1, min(self._wanted, -(-len(self._queue) // self.slots), self._may))
        task, self._queue = tuple(self._queue[:size]), self._queue[size:]
        self._may -= len(task)
        self.left -= len(task)
        if self._may <= 0:
            self._queue = []
        return task

    def _advance(self) -> None:
        """Go on with rounds, as long as all their results are there."""
        while not self._queue and all(r.run in self._sides for a in self._round for r in a.runs):
            for asked in self._round:
                mean = float(np.mean([self._sides[run.run] for run in asked.runs]))
                asked.learner.tell(asked.at, mean)
            self._round = list(self._ask())
            if not self._round:
                return
            runs = [run for asked in self._round for run in asked.runs]
            self.asked += runs
            self.found += sum(run.run in self._there for run in runs)
            self._queue = [run for run in runs if run.run not in self._sides]

    def _ask(self) -> Iterator[_Asked]:
        if not self._rounds:
            return
        self._rounds -= 1
        last = self._spec.runs % self._spec.batch or self._spec.batch
        n = self._spec.batch if self._rounds else last
        for chosen, learner in self._groups:
            for at in learner.ask(n)[0]:
                values = np.atleast_1d(np.asarray(at, dtype=np.float64)).tolist()
                drawn = {a.name: a.choice(u) for a, u in zip(self._drawn, values, strict=True)}
                runs = [
                    point(self._study, self._fingerprint, {**chosen, **drawn, **seed})
                    for seed in seeds(self._study)
                ]
                yield _Asked(learner, at, runs)


def listed_choices(study: Study) -> list[dict[str, Choice]]:
    """The combinations of listed axes, without seeds: each has a boundary of its own."""
    axes = [a for a in study.axes if isinstance(a, Listed) and a.name != SEED]
    return [
        {axis.name: choice for axis, choice in zip(axes, chosen, strict=True)}
        for chosen in product(*(axis.choices for axis in axes))
    ]


def seeds(study: Study) -> list[dict[str, Choice]]:
    """The seeds with which each point is run."""
    axes = [a for a in study.axes if isinstance(a, Listed) and a.name == SEED]
    return [{SEED: choice} for axis in axes for choice in axis.choices] or [{}]
