"""The result of a metric, and the integrals that metrics use."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isnan, sqrt

import numpy as np

from cosim.record.signals import Array


@dataclass(frozen=True, slots=True)
class MetricResult:
    """The result of a metric: `value` in `unit`, and further results as text and as numbers.

    `parts`, by name, are in `unit`, in s if the name ends in ``_s``, in Hz (``_hz``), or pure
    numbers (``_share``).
    """

    name: str
    label: str
    value: float
    unit: str
    detail: str = ""
    parts: Mapping[str, float] = field(default_factory=dict)

    def unit_of(self, part: str) -> str:
        """The unit of a part."""
        units = {"_s": "s", "_hz": "Hz", "_share": "1"}
        return next((u for end, u in units.items() if part.endswith(end)), self.unit)

    @property
    def text(self) -> str:
        """Value, unit and detail on one line."""
        if isnan(self.value):
            return f"no number: {self.detail}"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.value:.4g}{unit} {self.detail}".rstrip()


def length(x: Array) -> Array:
    """|x| of each row; (n, m) -> (n,)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", x, x)))


def integral(y: Array, t: Array) -> float:
    """∫ y dt by trapezoids; y, t (n,), s."""
    return float(0.5 * np.sum(np.diff(t) * (y[1:] + y[:-1])))


def root_mean_square(y: Array, t: Array) -> float:
    """sqrt(∫ y² dt / (t_n - t_0)), in the unit of `y`; y, t (n,), s."""
    duration = float(t[-1] - t[0])
    return sqrt(integral(y**2, t) / duration) if duration > 0 else float(abs(y[-1]))


def interval_text(t: Array) -> str:
    """``over 60 s``; t (n,) s."""
    return f"over {t[-1] - t[0]:.4g} s"


def times(unit: str, factor: str) -> str:
    """The unit of a product."""
    if not factor:
        return unit
    return factor if unit in ("", "1") else f"{unit}.{factor}"
