"""One number of an analysis: with its unit, how it was obtained, and the closed form next to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, isfinite, isnan, log10, nan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """`values` in `unit`, one or one per joint; `how`: their method.

    `error`: the uncertainty of each value, two standard deviations, in `unit`; () if the value is
    exact up to rounding and sampling. `expected`: values of the closed form, one each, () if there
    is none; `formula` names it. `note`: a remark on the use of the values, or the reason if they
    are missing.
    """

    name: str
    label: str
    values: tuple[float, ...]
    unit: str
    how: str
    error: tuple[float, ...] = ()
    expected: tuple[float, ...] = ()
    formula: str = ""
    note: str = ""

    @property
    def missing(self) -> bool:
        """True if the values are missing."""
        return not self.values or any(isnan(v) for v in self.values)

    @property
    def text(self) -> str:
        """The numbers with their unit."""
        if self.missing:
            return f"no number: {self.note}"
        return _text(self.values, self.unit, self.error)

    @property
    def expected_text(self) -> str:
        """The closed form with its unit and its formula."""
        if not self.expected:
            return ""
        return f"{_text(self.expected, self.unit)} = {self.formula}".rstrip(" =")

    def as_data(self) -> dict[str, Any]:
        """For JSON: infinite values as text, missing values as null."""
        return {
            "name": self.name,
            "label": self.label,
            "values": [_plain(v) for v in self.values],
            "unit": self.unit,
            "how": self.how,
            "error": [_plain(v) for v in self.error],
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
    error: ArrayLike = (),
    expected: ArrayLike = (),
    formula: str = "",
    note: str = "",
) -> Quantity:
    """A quantity of one value or several, in `unit`; `values`, `error`, `expected`: scalar or (m,).

    Values that are all equal are kept as one.
    """
    found = _alike(values)
    given = np.asarray(error, dtype=np.float64)
    spread = np.broadcast_to(given, np.shape(values)).ravel() if given.size else given
    return Quantity(
        name=name,
        label=label,
        values=found,
        unit=unit,
        how=how,
        error=tuple(float(e) for e in spread[: len(found)]),
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


def _text(values: Sequence[float], unit: str, error: Sequence[float] = ()) -> str:
    errors = [*error, *(0.0 for _ in values[len(error) :])]
    each = [with_error(v, e) for v, e in zip(values, errors, strict=True)]
    numbers = each[0] if len(set(each)) == 1 else f"({', '.join(each)})"
    return numbers if unit in ("", "1") else f"{numbers} {unit}"


def with_error(value: float, error: float) -> str:
    """``18.9 ± 1.1``, both in one unit; the error has two digits, or is left out if it is tiny."""
    if not isfinite(value) or not error > 5e-4 * abs(value):
        return f"{value:.4g}"
    if not isfinite(error):
        return f"{value:.2g} ± {error:g}"
    decimals = max(0, 1 - floor(log10(error)))
    return f"{value:.{decimals}f} ± {error:.{decimals}f}"


def _plain(value: float) -> float | str | None:
    if isnan(value):
        return None
    return value if isfinite(value) else str(value)
