"""A comparison as rows of texts, for the terminal, Markdown, CSV and JSON.

With several seeds a number is the median, followed by minimum and maximum. With one seed, an
estimated number is followed by two standard deviations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan
from statistics import median
from typing import Any

from cosim.comparison.comparison import Comparison
from cosim.comparison.measure import CaseOutcome
from cosim.comparison.spec import PortMeasure
from cosim.comparison.variants import MetricColumn

#: What stands where there is no number.
NOTHING = "–"
#: Behind a controller whose law needs a constant delay, on links whose delay varied.
MARK = "†"
#: Numbers below are shown as being so; times are told apart by 0.1 s.
SMALL = 1e-3
#: An uncertainty below this share of its number (or of SMALL) is not shown: it is in no digit.
VISIBLE = 2e-3
#: Share of the largest motion under the other controllers below which an arm does not move.
STILL = 0.01


@dataclass(frozen=True, slots=True)
class ComparisonRow:
    """A controller under an operator over a link law: one outcome a seed.

    `still`: position signals that do not move, though they do under another controller.
    """

    link: str
    operator: str
    controller: str
    marked: bool
    outcomes: tuple[CaseOutcome, ...]
    still: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """The controller's name, marked where its condition does not hold."""
        return f"{self.controller} {MARK}" if self.marked else self.controller

    def values(self, column: MetricColumn) -> list[float]:
        """The numbers of a column in its unit, one for each seed; empty if a run has none.

        Numbers of the port are there whatever became of the run.
        """
        of_run = not isinstance(column.metric, PortMeasure)
        if of_run and not all(o.verdict.ended for o in self.outcomes):
            return []
        values = [o.numbers.get(column.name, (nan, ""))[0] for o in self.outcomes]
        return [] if any(isnan(v) for v in values) else values

    def cell(self, column: MetricColumn, unit: str) -> str:
        """The text of a cell."""
        values = self.values(column)
        if not values:
            return NOTHING
        middle, low, high = (format_number(f(values), unit) for f in (median, min, max))
        error = self.outcomes[0].errors.get(column.name, 0.0)
        if len(values) == 1 and error > VISIBLE * max(abs(values[0]), SMALL):
            return f"{middle} ± {error:.2g}"
        return middle if low == high else f"{middle} [{low}, {high}]"

    @property
    def is_stable(self) -> bool:
        """True if the run with each seed came, or comes, to rest."""
        return all(o.verdict.stable for o in self.outcomes)

    @property
    def is_ranked(self) -> bool:
        """True if its numbers may be the best or the worst: it is stable, and everything moves."""
        return self.is_stable and not self.still

    @property
    def stable(self) -> str:
        """The column "stable?"."""
        verdicts = [o.verdict for o in self.outcomes]
        bad = [v for v in verdicts if not v.stable]
        if bad and len(verdicts) > 1:
            return bad[0].text + (f" ({len(bad)} of {len(verdicts)} seeds)")
        text = next((v for v in verdicts if v.kind != "at rest"), verdicts[0]).text
        return f"{text}; no motion of {', '.join(self.still)}" if self.still else text


def rows(comparison: Comparison) -> Iterator[ComparisonRow]:
    """The rows: by link law, operator, controller."""
    c = comparison
    for link in c.chosen.links:
        varies = c.tables.varies(link)
        for operator in c.chosen.operators:
            found = {name: c.of(link, operator, name) for name in c.chosen.controllers}
            still = _still(found)
            for name, outcomes in found.items():
                marked = varies and c.variants.controllers[name].constant_delay
                yield ComparisonRow(link, operator, name, marked, outcomes, still[name])


def _still(found: Mapping[str, Sequence[CaseOutcome]]) -> dict[str, tuple[str, ...]]:
    """The position signals that do not move under each controller, of those that move at all."""
    largest: dict[str, dict[str, float]] = {}
    for controller, outcomes in found.items():
        for outcome in outcomes:
            for signal, distance in outcome.verdict.motion.items():
                by = largest.setdefault(signal, {})
                by[controller] = max(distance, by.get(controller, 0.0))
    return {
        controller: tuple(
            signal
            for signal, by in largest.items()
            if by.get(controller, inf) < STILL * max(by.values())
        )
        for controller in found
    }


def columns(comparison: Comparison) -> list[tuple[MetricColumn, str]]:
    """The columns that apply to a selected operator, each with its unit."""
    c = comparison
    operators = [c.variants.operators[name] for name in c.chosen.operators]
    shown_ = [x for x in c.variants.columns if any(x.applies(o) for o in operators)]
    return [(column, _unit(column, c.outcomes)) for column in shown_]


def format_number(value: float, unit: str) -> str:
    """A number in `unit` as the table shows it; an infinite time is ``never``."""
    if value == inf:
        return "never" if unit == "s" else "∞"
    if unit == "s":
        return f"{value:.1f}"
    if 0 < abs(value) < SMALL:
        return f"<{SMALL:g}"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def header(column: MetricColumn, unit: str) -> str:
    """A column's label with its unit."""
    return column.label if unit in ("", "1") else f"{column.label} [{unit.replace('.', '·')}]"


def notes(comparison: Comparison) -> list[str]:
    """The notes below the table: why a run ended early, and the meaning of the mark."""
    every = list(rows(comparison))
    lines = []
    if any(row.marked for row in every):
        lines.append(f"{MARK} the law needs a constant delay, and the delay of this link varies")
    for row in every:
        reasons = [o.verdict.reason for o in row.outcomes if o.verdict.reason]
        if reasons:
            lines.append(f"{row.controller}, {row.operator}, {row.link}: {reasons[0]}")
        if row.outcomes[0].remark and row.operator == comparison.chosen.operators[0]:
            lines.append(f"{row.controller}, {row.link}: {row.outcomes[0].remark}")
    return lines


def runs_as_data(comparison: Comparison) -> list[dict[str, Any]]:
    """A mapping a run, for CSV and JSON: numbers in their units, NaN as None."""
    found = []
    for o in comparison.outcomes:
        v = o.verdict
        found.append(
            {
                "link": o.case.link, "operator": o.case.operator,
                "controller": o.case.controller, "seed": o.case.seed,
                "stable": v.stable, "verdict": v.kind, "ended_at_s": _plain(v.time),
                "speed_rad_s": _plain(v.speed), "reason": v.reason,
                "numbers": {name: _plain(x) for name, (x, _) in o.numbers.items()},
                "uncertainties": {name: _plain(x) for name, x in o.errors.items()},
            }
        )  # fmt: skip
    return found


def _plain(value: float) -> float | str | None:
    if isnan(value):
        return None
    return value if isfinite(value) else str(value)


def _unit(column: MetricColumn, outcomes: Sequence[CaseOutcome]) -> str:
    units = [o.numbers[column.name][1] for o in outcomes if column.name in o.numbers]
    return units[0] if units else ""
