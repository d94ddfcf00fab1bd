"""Points of a study: settings and identifier of each run.

Axes with listed values make a grid; axes that are drawn make `sample.count` samples; every point
of the grid is run with every sample (the same ones: what differs between two points of the grid is
then not that their samples differ).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from math import prod

from cosim.base.errors import ScenarioError
from cosim.study.axes import Cell, Choice, Drawn, Listed, setting_path, shares
from cosim.study.study import Study

#: More points than this are a mistake.
MOST = 10_000_000


@dataclass(frozen=True, slots=True)
class Point:
    """One run: what the table shows of it (by axis), and its settings, those of the study first.

    `run` is its name: a hash of everything that its numbers follow from.
    """

    run: str
    cells: Mapping[str, Cell]
    settings: tuple[str, ...]


def count(study: Study) -> int:
    """The number of points. Raises ScenarioError for more than anybody can run."""
    listed = prod(len(axis.choices) for axis in study.axes if isinstance(axis, Listed))
    drawn = study.sample.count if study.sample else study.boundary.runs if study.boundary else 1
    n = listed * drawn
    if n > MOST:
        raise ScenarioError(f"{n} runs; expected no more than {MOST}", study.place("vary"))
    return n


def points(study: Study, fingerprint: str = "") -> Iterator[Point]:
    """All points: the axes as in a nested loop, the first one slowest, samples fastest.

    `fingerprint`: of what all runs have in common, the scenario and its FMUs. Of a study with a
    boundary, whose points follow from results (:mod:`cosim.study.search`): the middle of its axes.
    """
    samples = _samples(study)
    grid = [axis for axis in study.axes if isinstance(axis, Listed)]
    for chosen in product(*(axis.choices for axis in grid)):
        listed = {axis.name: choice for axis, choice in zip(grid, chosen, strict=True)}
        for sample in samples:
            yield point(study, fingerprint, {**listed, **sample})


def point(study: Study, fingerprint: str, choices: Mapping[str, Choice]) -> Point:
    """The point with these choices, one for each axis."""
    common = [fingerprint, json.dumps(study.metrics, sort_keys=True), dict(study.stable)]
    if study.require or study.required:
        common += [json.dumps(study.require, sort_keys=True), list(study.required)]
    settings = (*study.settings, *_ordered(choices))
    cells = {axis.name: choices[axis.name].cell for axis in study.axes}
    return Point(_name([*common, settings]), cells, settings)


def _ordered(choices: Mapping[str, Choice]) -> list[str]:
    """Settings by path: a table is set before what is in it, in whatever order axes are listed."""
    settings = [s for choice in choices.values() for s in choice.settings]
    return sorted(settings, key=lambda s: setting_path(s).split("."))


def _samples(study: Study) -> list[dict[str, Choice]]:
    drawn = [axis for axis in study.axes if isinstance(axis, Drawn)]
    if study.boundary is not None:
        return [{axis.name: axis.choice(0.5) for axis in drawn}]
    if not drawn or study.sample is None:
        return [{}]
    n, seed, method = study.sample.count, study.sample.seed, study.sample.method
    columns = {axis.name: shares(method, n, seed, axis.name) for axis in drawn}
    return [{a.name: a.choice(float(columns[a.name][i])) for a in drawn} for i in range(n)]


def _name(what: object) -> str:
    text = json.dumps(what, sort_keys=True, ensure_ascii=False)
    return sha256(text.encode()).hexdigest()[:16]
