"""Axes: what varies from run to run, as settings ``path=value`` of the scenario."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, floor, isfinite, log
from statistics import NormalDist
from typing import Any, Literal, TypeAlias

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator

Cell: TypeAlias = float | int | bool | str
Distribution = Literal["uniform", "loguniform", "normal", "integers"]
Method = Literal["latin-hypercube", "monte-carlo"]


@dataclass(frozen=True, slots=True)
class Choice:
    """One value of an axis: what the table shows of it, and the settings that make it so."""

    cell: Cell
    settings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Listed:
    """An axis of a grid: every choice is combined with those of all other axes."""

    name: str
    choices: tuple[Choice, ...]

    @property
    def paths(self) -> frozenset[str]:
        """The places in the scenario that it sets."""
        return frozenset(setting_path(s) for choice in self.choices for s in choice.settings)


@dataclass(frozen=True, slots=True)
class Drawn:
    """An axis with random values; all `targets` receive the same. `unit`: of the value, or empty.

    ``uniform`` U[a, b], ``loguniform`` exp U[log a, log b], ``normal`` N(a, b²), ``integers`` a,
    a+1, …, b, with equal probability.
    """

    name: str
    targets: tuple[str, ...]
    law: Distribution
    a: float
    b: float
    unit: str = ""

    @property
    def paths(self) -> frozenset[str]:
        """The places in the scenario that it sets."""
        return frozenset(self.targets)

    def choice(self, u: float) -> Choice:
        """The quantile at `u`, 0 < u < 1."""
        value = self._value(u)
        return Choice(value, axis_settings(self.targets, value, self.unit))

    def _value(self, u: float) -> float | int:
        if self.law == "uniform":
            return self.a + u * (self.b - self.a)
        if self.law == "loguniform":
            return exp(log(self.a) + u * (log(self.b) - log(self.a)))
        if self.law == "normal":
            return NormalDist(self.a, self.b).inv_cdf(u)
        return min(int(self.b), floor(self.a + u * (self.b - self.a + 1)))

    def check(self, place: str) -> None:
        """Raise ScenarioError at `place` where the two numbers make no law."""
        a, b = self.a, self.b
        if not (isfinite(a) and isfinite(b)):
            raise ScenarioError(f"found [{a:g}, {b:g}], expected two finite numbers", place)
        if self.law == "normal":
            if b <= 0:
                raise ScenarioError(f"found deviation {b:g}, expected [mean, above 0]", place)
        elif a > b or (a == b and self.law != "integers"):
            raise ScenarioError(f"found [{a:g}, {b:g}], expected [low, high]", place)
        if self.law == "loguniform" and a <= 0:
            raise ScenarioError(f"found low = {a:g}, expected a number above 0", place)
        if self.law == "integers" and not (a.is_integer() and b.is_integer()):
            raise ScenarioError(f"found [{a:g}, {b:g}], expected whole numbers", place)


Axis: TypeAlias = Listed | Drawn


def shares(method: Method, count: int, seed: int, name: str) -> np.ndarray[Any, Any]:
    """`count` numbers u in (0, 1) for the axis `name`, (count,).

    ``monte-carlo``: independent, so that a greater `count` continues a smaller one.
    ``latin-hypercube``: one in each of `count` strata of equal size, in random order (McKay,
    Beckman and Conover 1979). Each axis is drawn from (seed, name), independent of other axes.
    """
    random = generator(seed, f"sweep:{name}")
    if method == "monte-carlo":
        return np.clip(random.random(count), 1e-16, None)
    order = random.permutation(count)
    return np.clip((order + random.random(count)) / count, 1e-16, 1 - 1e-16)


def spaced(low: float, high: float, count: int, scale: Literal["linear", "log"]) -> list[float]:
    """`count` numbers from `low` to `high`, both included, evenly spaced (on a log scale).

    All are in the unit of the value that is varied, rounded to 12 digits: 0.3 rather than
    0.30000000000000004.
    """
    if scale == "log":
        values = np.exp(np.linspace(log(low), log(high), count))
    else:
        values = np.linspace(low, high, count)
    return [float(f"{v:.12g}") for v in values]


def axis_settings(paths: Sequence[str], value: Any, unit: str = "") -> tuple[str, ...]:
    """The settings that give every path this value."""
    text = literal(f"{value!r} {unit}" if unit else value)
    return tuple(f"{path}={text}" for path in paths)


def setting_path(setting: str) -> str:
    """``a.b`` of ``a.b=3``."""
    return setting.partition("=")[0].strip()


def literal(value: Any) -> str:
    """A value as TOML. Raises ScenarioError for what a scenario's values cannot be (dates)."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(literal(v) for v in value)}]"
    if isinstance(value, Mapping):
        pairs = (f"{_quoted(k)} = {literal(v)}" for k, v in value.items())
        return f"{{{', '.join(pairs)}}}"
    raise ScenarioError(f"{value!r} cannot be a value of a scenario")


def _quoted(text: str) -> str:
    """A basic string of TOML: as in JSON, and DEL is escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
