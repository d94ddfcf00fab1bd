"""A study file: scenario, variations and measures. Every error names its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from cosim.base import toml
from cosim.base.convert import convert, convert_each
from cosim.base.errors import ScenarioError
from cosim.formulas.spec import RequirementSpec
from cosim.scenario.spec import MetricSpec
from cosim.study.axes import (
    Axis,
    Cell,
    Choice,
    Distribution,
    Drawn,
    Listed,
    axis_settings,
    literal,
    setting_path,
    spaced,
)
from cosim.study.spec import AxisSpec, BoundarySpec, SampleSpec, StudySpec, SweepFigureSpec

#: Columns of the table that are neither axes nor measures.
RESERVED = ("run", "stable", "reason", "stopped_at", "wall", "settings")
#: The axis of the seeds.
SEED = "seed"
_LAWS: tuple[Distribution, ...] = ("uniform", "loguniform", "normal", "integers")


@dataclass(frozen=True, slots=True)
class Study:
    """A study, checked as far as it can be without its scenario.

    `metrics`, `require`: tables of metrics and requirements as they are written, to be added to the
    scenario's; `required`: names of requirements that a stable run passes.
    """

    path: Path
    text: str
    title: str
    scenario: Path
    keep: Literal["nothing", "trajectories"]
    settings: tuple[str, ...]
    axes: tuple[Axis, ...]
    sample: SampleSpec | None
    boundary: BoundarySpec | None
    metrics: Mapping[str, Any]
    stable: Mapping[str, float]
    figures: Mapping[str, SweepFigureSpec]
    require: Mapping[str, Any]
    required: tuple[str, ...]

    def place(self, *path: str) -> str:
        """``FILE at vary.K``."""
        return f"{self.path} at {'.'.join(path)}"


def load_study(path: str | Path) -> Study:
    """Read a study file. Raises ScenarioError."""
    path = Path(path)
    text = toml.read_text(path, "a study file (.toml)")
    document = toml.parse(text, str(path))
    spec = convert(document, StudySpec, path)
    vary = convert_each(spec.vary, AxisSpec, path, "vary")
    axes = tuple(axis(name, one, f"{path} at vary.{name}") for name, one in vary.items())
    convert_each(spec.metrics, MetricSpec, path, "metrics")
    for name, requirement in convert_each(spec.require, RequirementSpec, path, "require").items():
        requirement.tree(f"{path} at require.{name}")
    bounds = dict(spec.stable)
    required = _required(bounds.pop("requirements", []), f"{path} at stable.requirements")
    study = Study(
        path, text, spec.title or path.stem, _scenario(spec.scenario, path), spec.keep,
        spec.settings, (*axes, *_seeds(spec.seeds, f"{path} at seeds")), spec.sample,
        spec.boundary, spec.metrics, _bounds(bounds, f"{path} at stable"),
        convert_each(spec.figures, SweepFigureSpec, path, "figures"), spec.require, required,
    )  # fmt: skip
    _check(study)
    return study


def _scenario(name: str, study: Path) -> Path:
    path = (study.parent / name).resolve()
    if not path.is_file():
        raise ScenarioError(f"{path}: no such file", f"{study} at scenario")
    return path


def _bounds(table: Mapping[str, Any], place: str, above: str = "") -> dict[str, float]:
    """``sync_error.settle_s = 30`` with its dot, which TOML takes for a table in a table."""
    found: dict[str, float] = {}
    for key, value in table.items():
        name = f"{above}{key}"
        if isinstance(value, dict):
            found |= _bounds(value, place, f"{name}.")
        elif isinstance(value, int | float) and not isinstance(value, bool) and value >= 0:
            found[name] = float(value)
        else:
            raise ScenarioError(f"found {value!r}, expected its maximum size", f"{place}.{name}")
    return found


def _required(given: Any, place: str) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
        raise ScenarioError(f"found {given!r}, expected a list of names of requirements", place)
    return tuple(given)


def _seeds(given: int | tuple[int, ...] | None, place: str) -> tuple[Axis, ...]:
    if given is None:
        return ()
    seeds = tuple(range(given)) if isinstance(given, int) else given
    if not seeds:
        raise ScenarioError("no seed; expected a number of seeds or a list", place)
    return (Listed(SEED, tuple(Choice(s, axis_settings(["run.seed"], s)) for s in seeds)),)


# ---- one axis -----------------------------------------------------------------------------------


def axis(name: str, spec: AxisSpec, place: str) -> Axis:
    """The axis that a table at `place` describes. Raises ScenarioError."""
    given = [k for k in ("values", "range", *_LAWS, "cases") if getattr(spec, k) is not None]
    if len(given) != 1:
        found = " and ".join(given) or "none of them"
        raise ScenarioError(
            f"found {found}; expected one of values, range, {', '.join(_LAWS)}, cases", place
        )
    paths = _paths(spec, given[0], place)
    if spec.cases is not None:
        return _cases(name, spec.cases, place)
    if spec.values is not None:
        return _values(name, paths, spec, place)
    if spec.range is not None:
        return _range(name, paths, spec, place)
    a, b = getattr(spec, given[0])
    law: Distribution = given[0]  # type: ignore[assignment]
    drawn = Drawn(name, paths, law, float(a), float(b), spec.unit)
    drawn.check(f"{place}.{law}")
    return drawn


def _paths(spec: AxisSpec, kind: str, place: str) -> tuple[str, ...]:
    paths = (*((spec.path,) if spec.path else ()), *spec.paths)
    if kind == "cases":
        if paths:
            raise ScenarioError("cases name their own paths; expected no key 'path'", place)
    elif not paths:
        raise ScenarioError("missing key 'path' or 'paths' (the value to vary)", place)
    if kind != "values" and spec.labels:
        raise ScenarioError("labels require values", f"{place}.labels")
    if kind != "range" and (spec.count is not None or spec.scale != "linear"):
        raise ScenarioError("count and scale require range", place)
    if kind in ("cases", "values") and spec.unit:
        raise ScenarioError(f"{kind} carry their own units, like '5 ms'", f"{place}.unit")
    return paths


def _cases(name: str, cases: Mapping[str, tuple[str, ...]], place: str) -> Listed:
    if not cases:
        raise ScenarioError("no case", f"{place}.cases")
    for case, settings in cases.items():
        for setting in settings:
            if "=" not in setting:
                raise ScenarioError(
                    f"found {setting!r}, expected path=value", f"{place}.cases.{case}"
                )
    return Listed(name, tuple(Choice(case, s) for case, s in cases.items()))


def _values(name: str, paths: tuple[str, ...], spec: AxisSpec, place: str) -> Listed:
    values = spec.values or ()
    if not values:
        raise ScenarioError("no value", f"{place}.values")
    if spec.labels and len(spec.labels) != len(values):
        raise ScenarioError(
            f"{len(spec.labels)} labels for {len(values)} values", f"{place}.labels"
        )
    plain = all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)
    choices = []
    for i, value in enumerate(values):
        try:
            cell: Cell = spec.labels[i] if spec.labels else value if plain else _cell(value)
            choices.append(Choice(cell, axis_settings(paths, value)))
        except ScenarioError as error:
            raise ScenarioError(str(error), f"{place}.values.{i}") from None
    return Listed(name, tuple(choices))


def _cell(value: Any) -> str:
    return value if isinstance(value, str) else literal(value)


def _range(name: str, paths: tuple[str, ...], spec: AxisSpec, place: str) -> Listed:
    low, high = spec.range or (0.0, 0.0)
    if spec.count is None:
        raise ScenarioError("missing key 'count' (number of points)", place)
    if not (isfinite(low) and isfinite(high)) or (spec.scale == "log" and min(low, high) <= 0):
        expected = "two numbers above 0" if spec.scale == "log" else "two finite numbers"
        raise ScenarioError(f"found [{low:g}, {high:g}], expected {expected}", f"{place}.range")
    values = spaced(low, high, spec.count, spec.scale)
    return Listed(name, tuple(Choice(v, axis_settings(paths, v, spec.unit)) for v in values))


# ---- the whole ----------------------------------------------------------------------------------


def _check(study: Study) -> None:
    names, paths = set[str](), dict[str, str]()
    for axis in study.axes:
        place = study.place("vary", axis.name)
        if axis.name in RESERVED or axis.name in names:
            raise ScenarioError(f"{axis.name!r} is the name of another column", place)
        names.add(axis.name)
        for path in sorted(axis.paths):
            if path in paths:
                raise ScenarioError(f"{path} is varied by {paths[path]!r} already", place)
            paths[path] = axis.name
    for setting in study.settings:
        if not setting_path(setting) or "=" not in setting:
            raise ScenarioError(f"found {setting!r}, expected path=value", study.place("settings"))
    drawn = [axis.name for axis in study.axes if isinstance(axis, Drawn)]
    if study.boundary is not None:
        _check_boundary(study, drawn)
    elif drawn and study.sample is None:
        raise ScenarioError(
            f"{', '.join(drawn)} to be drawn; missing key 'count' of [sample] (number of points)",
            str(study.path),
        )
    if study.sample is not None and not drawn:
        raise ScenarioError("no axis has a law to draw from", study.place("sample"))


def _check_boundary(study: Study, drawn: Sequence[str]) -> None:
    place = study.place("boundary")
    if study.sample is not None:
        raise ScenarioError("found [sample] as well, expected one of the two", place)
    if not 1 <= len(drawn) <= 3:
        raise ScenarioError(
            f"found {len(drawn)} axes with uniform or loguniform, expected one to three", place
        )
    for axis in study.axes:
        if isinstance(axis, Drawn) and axis.law not in ("uniform", "loguniform"):
            raise ScenarioError(
                f"found the law {axis.law}, expected uniform or loguniform for a boundary",
                study.place("vary", axis.name),
            )
