"""A claim of the paper: what is said, what is expected, how it is measured, and the verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isnan, nan
from typing import Any

from cosim.errors import CosimError, ScenarioError
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
        """Whether a measured value lies in the band; what is no number does not."""
        return self.low <= value <= self.high


def near(value: float, tolerance: float) -> Expected:
    """`value` ± `tolerance`, in the unit of the claim."""
    return Expected(value - tolerance, value + tolerance, f"{value:.5g} ± {tolerance:.2g}")


def relative(value: float, share: float) -> Expected:
    """`value` ± a share of it: 0.05 is 5 %."""
    tolerance = abs(value) * share
    return Expected(value - tolerance, value + tolerance, f"{value:.4g} ± {share * 100:g} %")


def within(low: float, high: float) -> Expected:
    """From `low` to `high`."""
    return Expected(low, high, f"{low:g} to {high:g}")


def at_most(high: float) -> Expected:
    """No more than `high`; of what cannot be negative."""
    return Expected(-inf, high, f"≤ {high:g}")


def at_least(low: float) -> Expected:
    """No less than `low`, and finite or not."""
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


@dataclass(frozen=True, slots=True)
class Verdict:
    """A claim with what was measured; NaN, and why in `note`, where nothing could be."""

    claim: Claim
    measured: float
    note: str = ""

    @property
    def passed(self) -> bool:
        """Whether what was measured lies in the expected band."""
        return self.claim.expected.holds(self.measured)

    def as_data(self) -> dict[str, Any]:
        """As ``claims.json`` holds it; infinite and missing numbers are null or text."""
        c, e = self.claim, self.claim.expected
        return {
            "name": c.name, "about": list(c.about), "text": c.text, "unit": c.unit,
            "expected": e.text, "low": _finite(e.low), "high": _finite(e.high),
            "measured": _finite(self.measured), "passed": self.passed, "source": c.source,
            "breaks": c.breaks, "cases": list(c.cases), "note": self.note,
        }  # fmt: skip


def judge(claim: Claim, found: Mapping[str, Run | Stop]) -> Verdict:
    """Measure a claim on what its cases left behind, by name.

    A case that stopped where the claim does not provide for it is a verdict, not an error.
    """
    runs = [found[case] for case in claim.cases]
    for case, run in zip(claim.cases, runs, strict=True):
        if isinstance(run, Stop) and not claim.stops:
            return Verdict(claim, nan, f"{case} stopped: {run.reason}")
    try:
        return Verdict(claim, float(claim.measure(*runs)))
    except CosimError as error:
        return Verdict(claim, nan, str(error))


def stopped(found: Run | Stop) -> float:
    """When a case stopped, s; inf if it ran to its end."""
    return found.time if isinstance(found, Stop) else inf


def select(claims: Sequence[Claim], wanted: Sequence[str]) -> list[Claim]:
    """The claims about what is wanted: ``6`` and ``fig6``, ``thm2``, ``O5``, or a claim's name.

    All of them if nothing is wanted. Raises ScenarioError for what no claim is about.
    """
    topics = {topic for c in claims for topic in (*c.about, c.name)}
    keys = [_key(w) for w in wanted]
    for given, key in zip(wanted, keys, strict=True):
        if key not in topics:
            known = ", ".join(sorted({t for c in claims for t in c.about}, key=_order))
            raise ScenarioError(f"--only {given!r}: nothing is called so; there are {known}")
    return [c for c in claims if not keys or set(keys) & {*c.about, c.name}]


def _key(wanted: str) -> str:
    text = wanted.strip().lower()
    return f"fig{text}" if text.isdigit() else text


def _order(topic: str) -> tuple[str, int]:
    head = topic.rstrip("0123456789")
    return head, int(topic[len(head) :] or 0)


def _finite(value: float) -> float | str | None:
    if isnan(value):
        return None
    return value if abs(value) < inf else str(value)
