"""Structs of a study file; their fields are the permitted keys."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from cosim.study.axes import Method

Pair = tuple[float, float]
Natural = Annotated[int, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=1)]


class AxisSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One axis: a path (or several that move together), and one of the keys that give values."""

    path: str = ""
    paths: tuple[str, ...] = ()
    unit: str = ""
    values: tuple[Any, ...] | None = None
    labels: tuple[str, ...] = ()
    range: Pair | None = None
    count: Count | None = None
    scale: Literal["linear", "log"] = "linear"
    uniform: Pair | None = None
    loguniform: Pair | None = None
    normal: Pair | None = None
    integers: Pair | None = None
    cases: dict[str, tuple[str, ...]] | None = None


class SampleSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The number of draws of the axes that are drawn, and their kind."""

    count: Count
    method: Method = "latin-hypercube"
    seed: Natural = 0


class BoundarySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The boundary of the region where runs are stable, or a measure is at most `level`.

    `runs`: points to find it with, each with all seeds; `batch`: how many are chosen at a time.
    """

    of: str = "stable"
    level: Annotated[float, msgspec.Meta(gt=0)] = 1.0
    runs: Count = 500
    batch: Count = 16


class SweepFigureSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A figure of the table; see :mod:`cosim.study.figures`."""

    kind: Literal["map", "line", "points"]
    x: str
    y: str
    z: str = ""
    by: str = ""
    reduce: Literal["mean", "median", "min", "max"] = "mean"
    title: str = ""
    xlabel: str = ""
    ylabel: str = ""
    zlabel: str = ""
    logx: bool = False
    logy: bool = False


class StudySpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The whole file, as read. `stable`: the largest size each measure may have, and the names of
    `requirements` that are to pass.
    """

    scenario: str
    title: str = ""
    keep: Literal["nothing", "trajectories"] = "nothing"
    settings: tuple[str, ...] = ()
    seeds: Natural | tuple[Natural, ...] | None = None
    vary: dict[str, dict[str, Any]] = {}
    sample: SampleSpec | None = None
    boundary: BoundarySpec | None = None
    metrics: dict[str, dict[str, Any]] = {}
    require: dict[str, dict[str, Any]] = {}
    stable: dict[str, Any] = {}
    figures: dict[str, dict[str, Any]] = {}
