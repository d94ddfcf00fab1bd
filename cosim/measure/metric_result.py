"""The result of a metric, its lines in a summary, and the integrals that metrics use."""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan

import numpy as np

from cosim.base.convert import Struct, field
from cosim.record.signals import Array

#: Columns of the labels of a summary.
LABELS = 22


class MetricResult(Struct, frozen=True):
    """The result of a metric: `value` in `unit`, and further results as text and as numbers.

    `parts`, by name, are in `unit`, in s if the name ends in ``_s``, in Hz (``_hz``), or pure
    numbers (``_share``). `more`: label and text of each further fact.
    """

    name: str
    label: str
    value: float
    unit: str
    detail: str = ""
    parts: Mapping[str, float] = field(default_factory=dict)
    more: tuple[tuple[str, str], ...] = ()

    def unit_of(self, part: str) -> str:
        """The unit of a part."""
        units = {"_s": "s", "_hz": "Hz", "_share": "1"}
        return next((u for end, u in units.items() if part.endswith(end)), self.unit)

    @property
    def numbers(self) -> dict[str, tuple[float, str]]:
        """The value and the parts by name, ``effort`` and ``effort.PART``, each with its unit."""
        parts = {f"{self.name}.{k}": (float(x), self.unit_of(k)) for k, x in self.parts.items()}
        return {self.name: (float(self.value), self.unit), **parts}

    @property
    def text(self) -> str:
        """Value, unit and detail on one line."""
        if isnan(self.value):
            return f"no number: {self.detail}"
        return f"{with_unit(self.value, self.unit, 4)} {self.detail}".rstrip()

    @property
    def facts(self) -> tuple[tuple[str, str], ...]:
        """Label and text of each fact: the value, then the further ones."""
        return ((self.label, self.text), *self.more)


def summary_line(label: str, text: str) -> str:
    """A line of a summary."""
    return f"{label:<{LABELS}} {text}"


def with_unit(value: float, unit: str, digits: int = 3) -> str:
    """A number of `digits` significant digits with its unit; a pure number has none."""
    return f"{value:.{digits}g}" + ("" if unit in ("", "1") else f" {unit}")


def length(x: Array) -> Array:
    """|x| of each row; (n, m) -> (n,)."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", x, x)))


def times(unit: str, factor: str) -> str:
    """The unit of a product."""
    if not factor:
        return unit
    return factor if unit in ("", "1") else f"{unit}.{factor}"
