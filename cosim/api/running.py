"""``cosim.run``, ``open``, ``check``, ``compare``, ``sweep``: one call for a command each."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.api import given
from cosim.api.arguments import expect
from cosim.api.results import RunResult
from cosim.base.toml import as_toml, change
from cosim.record import Run
from cosim.scenario.spec import Scenario, build

if TYPE_CHECKING:
    from cosim.checks import Finding
    from cosim.comparison.comparison import Comparison
    from cosim.study.run_point import StudyRow
    from cosim.study.table import SweepTable

#: ``links[0]`` as a path has it: ``links.0``.
_INDEX = re.compile(r"\[(\d+)\]")
#: Tables whose keys are names of variables, with the index of an entry.
_OF_VARIABLES = re.compile(r"components\.[^.]+\.(parameters|start|inputs)\.")
#: A scenario: a file, or a document with the keys of one.
Given = str | Path | Mapping[str, Any]
#: Kinds of arguments (cosim/api/arguments.py).
_OF_RUN = {
    "scenario": "scenario",
    "set": "changes?",
    "seed": "whole?",
    "stop": "time?",
    "out": "path?",
    "progress": "of two",
}
_OF_COMPARE = {
    "scenario": "path",
    **dict.fromkeys(("controllers", "operators", "links"), "texts"),
    "variants": "path?",
    "seeds": "count",
    "set": "changes?",
    "jobs": "count",
}
_OF_SWEEP = {
    "study": "path",
    "out": "path",
    "jobs": "count",
    "resume": "flag",
    "limit": "count?",
    "each": "of one",
}


def run(
    scenario: Given,
    *,
    set: Mapping[str, Any] | None = None,
    seed: int | None = None,
    stop: float | str | None = None,
    out: str | Path | None = None,
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> RunResult:
    """Run a scenario in this process and return what it recorded.

    `scenario`: a file (.toml, .ssp), or a mapping with the same keys, where ``model`` of a
    component may be a Python class or function. `set`: values by dotted path, as
    ``{"links[0].delay.high": "1 s"}``; `seed`, and `stop`, s, instead of those of the scenario.
    `out`: the run folder, which must be empty; by default a temporary one. `progress` is called
    with (ticks done, ticks in all). Raises CosimError as the command does; an FMU that crashes
    takes this process with it.
    """
    from cosim.engine.simulate import simulate

    expect("run", _OF_RUN, locals())
    changes = {**({} if stop is None else {"run.stop": stop}), **(set or {})}
    loaded = _loaded(scenario, changes, seed)
    kept = TemporaryDirectory(prefix="cosim-") if out is None else None
    folder = Path(kept.name, "run") if kept else Path(str(out))
    simulate(loaded, folder, progress, further={"command": _command(scenario, changes, seed)})
    return RunResult(Run.open(folder), kept)


def open(folder: str | Path) -> RunResult:
    """A run folder, of a run, a rehearsal or a replay. Raises ScenarioError."""
    expect("open", {"folder": "path"}, locals())
    return RunResult(Run.open(folder))


def check(
    scenario: Given,
    *,
    set: Mapping[str, Any] | None = None,
) -> tuple[Finding, ...]:
    """The findings of ``cosim check``, worst first. Raises CosimError for no scenario at all."""
    from cosim.checks.preflight import check as findings
    from cosim.scenario.assemble import assemble

    expect("check", {"scenario": "scenario", "set": "changes?"}, locals())
    loaded = _loaded(scenario, set, None)
    return tuple(findings(loaded, assemble(loaded)))


def compare(
    scenario: str | Path,
    *,
    controllers: Sequence[str] = (),
    operators: Sequence[str] = (),
    links: Sequence[str] = (),
    variants: str | Path | None = None,
    seeds: int = 1,
    set: Mapping[str, Any] | None = None,
    jobs: int = 1,
) -> Comparison:
    """Compare controllers as ``cosim compare`` does; empty names mean the file's default.

    `variants`: the file that defines the names, by default the one in ``compare/`` next to the
    scenario; `seeds`: how many, from the scenario's on. Raises CosimError.
    """
    from cosim.comparison.comparison import compare as compare_all
    from cosim.comparison.documents import check as refuse
    from cosim.comparison.documents import read_base
    from cosim.comparison.requirement_columns import with_requirements
    from cosim.comparison.variants_file import read, variants_path

    expect("compare", _OF_COMPARE, locals())
    known = read(variants or variants_path(scenario))
    chosen = known.select(list(controllers), list(operators), list(links))
    base = read_base(scenario, known, as_settings(set))
    known = with_requirements(known, base)
    refuse(base, known, chosen)
    return compare_all(base, known, chosen, range(base.seed, base.seed + seeds), jobs=jobs)


def sweep(
    study: str | Path,
    out: str | Path,
    *,
    jobs: int = 1,
    resume: bool = False,
    limit: int | None = None,
    each: Callable[[StudyRow], None] = lambda row: None,
) -> SweepTable:
    """Run a parameter study into the folder `out`, with `jobs` processes; return its table.

    `each` is called with every row as it comes. `resume` continues a study that the folder
    contains; `limit`: at most so many runs now. Raises CosimError.
    """
    from functools import partial

    from cosim.base.processes import processes
    from cosim.study import execute
    from cosim.study.runner import Observer
    from cosim.study.study import load_study

    expect("sweep", _OF_SWEEP, locals())
    extent = execute.Extent(resume=resume, limit=limit)
    opened, observer = partial(processes, jobs), Observer(done=each)
    return execute.sweep(load_study(Path(study)), out, opened, extent, observer)


def _command(scenario: Given, changes: Mapping[str, Any], seed: int | None) -> str:
    """The command that does the same as :func:`run`; "": none does, it needs this program."""
    settings = _all_settings(changes, seed)
    if isinstance(scenario, Mapping) or any(given.__name__ in setting for setting in settings):
        return ""
    sets = [word for setting in settings for word in ("--set", setting)]
    return shlex.join(["cosim", "run", str(Path(scenario).absolute()), *sets])


def _all_settings(changes: Mapping[str, Any] | None, seed: int | None) -> list[str]:
    return as_settings(changes) + ([f"run.seed={seed}"] if seed is not None else [])


def _loaded(scenario: Given, set_: Mapping[str, Any] | None, seed: int | None) -> Scenario:
    settings = _all_settings(set_, seed)
    if not isinstance(scenario, Mapping):
        from cosim.loading.files import load

        return load(scenario, settings)
    document = _document(scenario)
    for setting in settings:
        change(document, setting)
    return build(document, Path("scenario.toml"))


def _document(value: Any) -> Any:
    """A copy of a document, with the names of Python objects that make components."""
    if isinstance(value, Mapping):
        return {key: _document(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [_document(x) for x in value]
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return given.name_of(value) if callable(value) else value


def as_settings(values: Mapping[str, Any] | None) -> list[str]:
    """``path=value`` texts, as the command line has them, of values by dotted path."""
    paths = {
        path if _OF_VARIABLES.match(path) else _INDEX.sub(r".\1", path): value
        for path, value in (values or {}).items()
    }
    return [f"{path}={as_toml(_document(value))}" for path, value in paths.items()]
