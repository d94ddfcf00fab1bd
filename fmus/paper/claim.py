"""A claim of the paper: its statement, expected value, measurement and verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf, isnan, nan
from typing import Any

from cosim.base.errors import CosimError
from cosim.record import Run


@dataclass(frozen=True, slots=True)
class Stop:
    """A run that ended before its time: at `time` (s), and why."""

    time: float
    reason: str


@dataclass(frozen=True, slots=True)
class Expected:
    """A band, ends included; `text` is how it is printed (without the unit)."""

    low: float
    high: float
    text: str

    def holds(self, value: float) -> bool:
        """True if a measured value lies in the band; what is no number does not."""
        return self.low <= value <= self.high


def absolute(value: float, tolerance: float) -> Expected:
    """`value` ± `tolerance`, in the unit of the claim."""
    return Expected(value - tolerance, value + tolerance, f"{value:.5g} ± {tolerance:.2g}")


def relative(value: float, share: float) -> Expected:
    """`value` ± a share of it: 0.05 is 5 %."""
    tolerance = abs(value) * share
    return Expected(value - tolerance, value + tolerance, f"{value:.4g} ± {share * 100:g} %")


def within(low: float, high: float) -> Expected:
    """The range from `low` to `high`, ends included, in the unit of the claim."""
    return Expected(low, high, f"{low:g} to {high:g}")


def at_most(high: float) -> Expected:
    """At most `high`, in the unit of the claim; for values that cannot be negative."""
    return Expected(-inf, high, f"≤ {high:g}")


def at_least(low: float) -> Expected:
    """At least `low`, in the unit of the claim; an infinite value holds as well."""
    return Expected(low, inf, f"≥ {low:g}")


def never() -> Expected:
    """A time that does not come: inf."""
    return Expected(inf, inf, "never")


@dataclass(frozen=True, slots=True)
class Claim:
    """One line of the table.

    `about`: what ``--only`` finds it by (``fig6``, ``thm3``, ``o2``, ...), the first is its home;
    `source`: where the expectation comes from; `cases`: the runs it needs, which `measure` gets in
    that order and turns into one number in `unit`. `breaks`: the hypothesis of a theorem that is
    broken here, so that its conclusion is expected to fail. `stops`: a case may stop before its
    time, and `measure` gets a :class:`Stop` for it.
    """

    name: str
    about: tuple[str, ...]
    text: str
    unit: str
    expected: Expected
    source: str
    cases: tuple[str, ...]
    measure: Callable[..., float]
    breaks: str = ""
    stops: bool = False

    def as_data(self) -> dict[str, Any]:
        """The expected value as ``claims.json`` holds it; what is not finite is text or null."""
        return {
            "name": self.name, "about": list(self.about), "text": self.text, "unit": self.unit,
            "expected": self.expected.text, "low": _finite(self.expected.low),
            "high": _finite(self.expected.high), "source": self.source, "breaks": self.breaks,
            "cases": list(self.cases),
        }  # fmt: skip


@dataclass(frozen=True, slots=True)
class ClaimVerdict:
    """A claim with what was measured; NaN, and why in `note`, where nothing could be."""

    claim: Claim
    measured: float
    note: str = ""

    @property
    def passed(self) -> bool:
        """True if what was measured lies in the expected band."""
        return self.claim.expected.holds(self.measured)

    def as_data(self) -> dict[str, Any]:
        """The claim as ``claims.json`` holds it."""
        measured = _finite(self.measured)
        return {
            **self.claim.as_data(), "measured": measured, "passed": self.passed, "note": self.note,
        }  # fmt: skip


def judge(claim: Claim, found: Mapping[str, Run | Stop]) -> ClaimVerdict:
    """Measure a claim on what its cases left behind, by name.

    A case that stopped where the claim does not provide for it is a verdict, not an error.
    """
    runs = [found[case] for case in claim.cases]
    for case, run in zip(claim.cases, runs, strict=True):
        if isinstance(run, Stop) and not claim.stops:
            return ClaimVerdict(claim, nan, f"{case} stopped: {run.reason}")
    try:
        return ClaimVerdict(claim, float(claim.measure(*runs)))
    except CosimError as error:
        return ClaimVerdict(claim, nan, str(error))


def stopped(found: Run | Stop) -> float:
    """The time at which a case stopped, s; inf if it ran to its end."""
    return found.time if isinstance(found, Stop) else inf


def _finite(value: float) -> float | str | None:
    if isnan(value):
        return None
    return value if abs(value) < inf else str(value)
