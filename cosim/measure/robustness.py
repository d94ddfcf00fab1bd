"""The result of a requirement: verdict, margin, time, in words and as data."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf, isfinite, nan
from typing import Any, Literal

from cosim.base.convert import Struct
from cosim.base.units import time_text
from cosim.measure.metric_result import with_unit

Verdict = Literal["passed", "failed", "inconclusive"]


class Robustness(Struct, frozen=True):
    """The robustness of a requirement on a run.

    `value`: the margin in `unit`, negative where it is violated; -inf for a run that diverged or
    stopped; NaN where nothing was recorded that it is about. `time`: of the row that decides it, s,
    or NaN. `text`: verdict, margin and time in words; `condition`: the requirement as it is
    written; `recorded`: whether the signals that it reads were recorded.
    """

    name: str
    verdict: Verdict
    value: float
    unit: str
    time: float
    text: str
    condition: str = ""
    recorded: bool = True

    @property
    def line(self) -> str:
        """``near: passed, margin 0.42 rad, closest at 12.3 s``."""
        return f"{self.name}: {self.text}"

    @property
    def margin(self) -> str:
        """The margin with its unit; "" where there is none."""
        return "" if self.value != self.value else with_unit(self.value, self.unit, 4)

    def as_data(self) -> dict[str, Any]:
        """For JSON; a number that is infinite is a text, one that is missing null."""
        return {
            "verdict": self.verdict, "margin": plain(self.value), "unit": self.unit,
            "at_s": plain(self.time), "text": self.text, "condition": self.condition,
        }  # fmt: skip


def plain(x: float) -> float | str | None:
    """A number, in any unit, for JSON: a text if it is infinite, None for NaN."""
    return x if isfinite(x) else None if x != x else str(x)


def worst(results: Iterable[Robustness]) -> Verdict | None:
    """The verdict on all together: failed if one is, else inconclusive if one is; None: none."""
    found = {result.verdict for result in results}
    order: tuple[Verdict, ...] = ("failed", "inconclusive", "passed")
    return next((verdict for verdict in order if verdict in found), None)


def stopped(name: str, unit: str, time: float, why: str, condition: str) -> Robustness:
    """The result on a run that diverged or failed at a time (s, or NaN)."""
    at = f" at {time_text(time)}" if isfinite(time) else ""
    return Robustness(name, "failed", -inf, unit, time, f"failed, {why}{at}", condition)


def undecided(name: str, unit: str, why: str, condition: str) -> Robustness:
    """The result where it cannot be told: no margin."""
    return Robustness(name, "inconclusive", nan, unit, nan, f"inconclusive: {why}", condition)
