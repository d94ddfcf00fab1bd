"""The figures a scenario declares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cosim.reporting.figures import Figure, Panel
from cosim.reporting.marks import failure, marks
from cosim.scenario.spec import Scenario


def figure_specs(scenario: Scenario, facts: Mapping[str, Any]) -> dict[str, Figure]:
    """The scenario's figures, by name, with what happened in the run of ``run.json``, `facts`."""
    return {
        name: Figure(
            title=spec.title or scenario.title,
            events=tuple(marks(facts)),
            failure=failure(facts),
            panels=tuple(
                Panel(
                    y=p.y, title=p.title, labels=p.labels, reference=p.reference,
                    reference_label=p.reference_label, ylabel=p.ylabel,
                )
                for p in spec.panels
            ),
        )
        for name, spec in scenario.figures.items()
    }  # fmt: skip
