"""The margin of a requirement as the number of a column."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.measure import requirements
from cosim.measure.metric_result import MetricResult
from cosim.record import Run
from cosim.scenario.spec import build


@dataclass(frozen=True, slots=True)
class RequirementMargin:
    """The margin of the only requirement of a `document`, a scenario without components.

    `signals`: names of the signals that it reads; `path`: of the scenario.
    """

    name: str
    document: Mapping[str, Any]
    signals: tuple[str, ...]
    path: Path

    def evaluate(self, run: Run) -> MetricResult:
        """The margin, with the verdict as its detail. Raises ScenarioError."""
        found = requirements.of_run(build(self.document, self.path), run)[0]
        return MetricResult(self.name, self.name, found.value, found.unit, found.text)
