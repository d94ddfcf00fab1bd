"""The figures a scenario declares."""

from __future__ import annotations

from cosim.reporting.figures import Figure, Panel
from cosim.scenario.spec import Scenario


def figure_specs(scenario: Scenario) -> dict[str, Figure]:
    """The scenario's figures, by name."""
    return {
        name: Figure(
            title=spec.title or scenario.title,
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
