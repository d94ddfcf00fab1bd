"""One number of an analysis: with its unit, how it was obtained, and the closed form next to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, isnan, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """`values` in `unit`, one or one a joint; `how` they came about.

    `expected`: the closed form, as many, () where there is none; `formula` says which. `note`: what
    to know before using it; where there is no number, why.
    """

    name: str
    label: str
    values: tuple[float, ...]
    unit: str
    how: str
    expected: tuple[float, ...] = ()
    formula: str = ""
    note: str = ""

    @property
    def missing(self) -> bool:
        """Whether there is no number."""
        return not self.values or any(isnan(v) for v in self.values)

    @property
    def text(self) -> str:
        """The numbers with their unit."""
        return f"no number: {self.note}" if self.missing else _text(self.values, self.unit)

    @property
    def expected_text(self) -> str:
        """The closed form with its unit, and what it is."""
        if not self.expected:
            return ""
        return f"{_text(self.expected, self.unit)} = {self.formula}".rstrip(" =")

    def as_data(self) -> dict[str, Any]:
        """For JSON: what is infinite is a text, what is missing null."""
        return {
            "name": self.name,
            "label": self.label,
            "values": [_plain(v) for v in self.values],
            "unit": self.unit,
            "how": self.how,
            "expected": [_plain(v) for v in self.expected],
            "formula": self.formula,
            "note": self.note,
        }


def quantity(
    name: str,
    label: str,
    values: ArrayLike,
    unit: str,
    how: str,
    *,
    expected: ArrayLike = (),
    formula: str = "",
    note: str = "",
) -> Quantity:
    """A quantity of one value or several, in `unit`; `values` and `expected` are scalar or (m,).

    Values that are all equal are kept as one.
    """
    return Quantity(
        name=name,
        label=label,
        values=_alike(values),
        unit=unit,
        how=how,
        expected=_alike(expected),
        formula=formula,
        note=note,
    )


def absent(name: str, label: str, unit: str, how: str, why: str) -> Quantity:
    """A quantity that cannot be had, and why."""
    return Quantity(name=name, label=label, values=(nan,), unit=unit, how=how, note=why)


def _alike(values: ArrayLike) -> tuple[float, ...]:
    found = tuple(float(v) for v in np.atleast_1d(np.asarray(values, dtype=np.float64)))
    return found[:1] if found and all(v == found[0] for v in found) else found


def _text(values: Sequence[float], unit: str) -> str:
    each = [f"{v:.4g}" for v in values]
    numbers = each[0] if len(set(each)) == 1 else f"({', '.join(each)})"
    return numbers if unit in ("", "1") else f"{numbers} {unit}"


def _plain(value: float) -> float | str | None:
    if isnan(value):
        return None
    return value if isfinite(value) else str(value)
