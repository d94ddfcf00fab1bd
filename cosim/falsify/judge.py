"""The margins of a run: how far the requirements of its scenario are from being violated.

A run that diverges or fails violates all of them; the sooner it does, the worse it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan

from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.measure.requirements import Requirement
from cosim.measure.requirements import requirements as declared
from cosim.record import Column
from cosim.record.signals import Signals
from cosim.scenario.spec import Scenario

#: The score of a run that fails at its end; one that fails at its start has one less.
DIVERGED = -1e6


@dataclass(frozen=True, slots=True)
class Margin:
    """The margin of a requirement: `value` in `unit`, negative if it is violated; NaN: undecided.

    `time`: of the row that decides it, s; NaN for one of the whole run.
    """

    value: float
    unit: str
    time: float


def margin(requirement: Requirement, signals: Signals) -> Margin:
    """The margin of a requirement on recorded signals. Raises ScenarioError as it does."""
    found = requirement.evaluate(signals)
    value = nan if found.verdict == "inconclusive" else found.value
    return Margin(value, found.unit, found.time)


def requirements(
    scenario: Scenario, wanted: Sequence[str], columns: Sequence[Column]
) -> tuple[Requirement, ...]:
    """The requirements of a scenario, those that are `wanted`, or all.

    `columns`: those that a run records. Raises ScenarioError.
    """
    found = {one.name: one for one in declared(scenario, {c.name: c.unit for c in columns})}
    if not found:
        raise ScenarioError(
            "no requirement that could be violated; expected [require.NAME]", str(scenario.path)
        )
    for name in wanted:
        if name not in found:
            raise ScenarioError(
                unknown(name, found, "requirement"), scenario.place("falsify", "require")
            )
    return tuple(found[name] for name in wanted or found)


@dataclass(frozen=True, slots=True)
class CandidateOutcome:
    """The result of a candidate: its `key`, the margin of each requirement by name.

    `reason`: why it has none, empty if it has; `stopped_at`: the time at which it failed, s, else
    NaN; `wall`: its wall time, s.
    """

    key: str
    margins: Mapping[str, Margin]
    reason: str = ""
    stopped_at: float = nan
    wall: float = nan

    def fails(self, name: str = "") -> bool:
        """True if the requirement is violated; without a name: any."""
        if self.reason:
            return True
        margins = [self.margins[name]] if name else self.margins.values()
        return any(margin.value < 0 for margin in margins)

    @property
    def passes(self) -> bool:
        """True if all requirements hold."""
        return not self.reason and all(margin.value >= 0 for margin in self.margins.values())


def score(outcome: CandidateOutcome, scales: Mapping[str, float], end: float) -> float:
    """The least margin of an outcome, without a unit: each is divided by its size in `scales`.

    `end`: of the run, s. A search makes it small.
    """
    if outcome.reason:
        t = outcome.stopped_at if isfinite(outcome.stopped_at) else end
        return DIVERGED - (1.0 - t / end)
    values = [m.value / scales[name] for name, m in outcome.margins.items() if m.value == m.value]
    return max(DIVERGED, min(values, default=inf))


def scales_of(nominal: CandidateOutcome) -> dict[str, float]:
    """The sizes of the nominal margins, in their units: 1 where one is 0 or no number."""
    return {
        name: abs(m.value) if isfinite(m.value) and m.value else 1.0
        for name, m in nominal.margins.items()
    }
