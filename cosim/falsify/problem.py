"""A scenario as a problem: what may move, and the common part of all candidates."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from hashlib import sha256
from pathlib import Path
from typing import Any

from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.toml import change, changed
from cosim.falsify import judge, spec
from cosim.falsify.bounds import MovingChannel, channels
from cosim.falsify.evaluation import Problem
from cosim.falsify.paths import Candidate
from cosim.loading.files import read_document
from cosim.scenario.arrays import expand
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build, has_many
from cosim.schedule.plan import Plan
from cosim.study.axes import Axis, Listed
from cosim.study.run_point import recorded_columns
from cosim.study.runner import fingerprint_of


def document_of(path: Path, settings: Sequence[str]) -> dict[str, Any]:
    """The scenario in a file with these settings, as parsed, and expanded. Raises ScenarioError."""
    document = read_document(path)
    for key in ("falsify", "require"):
        document.setdefault(key, {})
    for setting in settings:
        change(document, setting)
    return expand(document, path) if has_many(document) else document


def problem_of(path: Path, settings: Sequence[str] = ()) -> tuple[Problem, spec.FalsifySpec]:
    """The problem of the scenario in a file, and its table [falsify].

    Raises ScenarioError, also if there is no requirement, or nothing that may move.
    """
    document = document_of(path, settings)
    scenario = build(document, path)
    given = spec.read(scenario)
    plan = assemble(scenario)
    wanted = judge.requirements(scenario, given.require, recorded_columns(scenario, plan))
    found = tuple(c for c in channels(scenario, plan, given.links) if c.moves)
    axes = spec.axes(scenario, given)
    if not found and not axes:
        raise ScenarioError(
            "nothing can move: no link has delays that vary, and [falsify] gives neither bounds "
            'nor values; expected [falsify.links."*"] or [falsify.vary.NAME]',
            str(path),
        )
    base = _base(document, found)
    problem = Problem(
        path, base, found, axes, tuple(one.name for one in wanted), plan.ticks, plan.h,
        _name(base, found, axes, plan), tuple(link.name for link in plan.links),
        tuple(dict.fromkeys(s for one in wanted for s in one.signals)),
    )  # fmt: skip
    _check_axes(problem, scenario.place("falsify", "vary"))
    return problem, given


def _base(document: Mapping[str, Any], found: Sequence[MovingChannel]) -> dict[str, Any]:
    """The document with the nominal delay on all channels that may move."""
    base = deepcopy({**document})
    for channel in found:
        for i in channel.links:
            base["links"][i].pop("loss", None)
            base["links"][i]["delay"] = {"law": "segments", "delay": channel.nominal}
    return base


def _name(
    base: Mapping[str, Any], found: Sequence[MovingChannel], axes: Sequence[Axis], plan: Plan
) -> str:
    text = json.dumps(base, sort_keys=True, default=str)
    facts = repr([replace(c, laws=()) for c in found]) + repr(axes)
    facts += repr([law.facts() for c in found for law in c.laws])
    return fingerprint_of(sha256((text + facts).encode()).digest(), [plan])


def _check_axes(problem: Problem, place: str) -> None:
    """Build the scenario with the ends of each axis. Raises ScenarioError."""
    for i, axis in enumerate(problem.axes):
        ends = range(len(axis.choices)) if isinstance(axis, Listed) else (0.001, 0.999)
        n = len(axis.choices) if isinstance(axis, Listed) else 1
        for end in ends:
            u = (end + 0.5) / n if isinstance(axis, Listed) else end
            axes = tuple(u if j == i else None for j in range(len(problem.axes)))
            candidate = replace(problem.nominal, axes=axes)
            try:
                check_candidate(problem, candidate)
            except CosimError as error:
                raise ScenarioError(str(error), f"{place}.{axis.name}") from None


def check_candidate(problem: Problem, candidate: Candidate) -> Plan:
    """The plan of a candidate's values, with nominal delays. Raises CosimError."""
    document = changed(problem.document, problem.settings(candidate))
    return assemble(build(document, problem.path))
