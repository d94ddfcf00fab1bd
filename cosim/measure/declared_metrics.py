"""The metrics a scenario declares."""

from __future__ import annotations

from cosim.measure.metrics import Metric, metric
from cosim.scenario.spec import Scenario


def metrics(scenario: Scenario) -> list[Metric]:
    """The scenario's metrics, durations in s. Raises ScenarioError with the place of an error."""
    found = []
    for name, spec in scenario.metrics.items():
        window = spec.window
        seconds = None if window is None else scenario.seconds(window, "metrics", name, "window")
        found.append(
            metric(
                name,
                spec.kind,
                spec.of,
                target=spec.target,
                within=spec.within,
                window=seconds,
                contact=spec.contact,
                norm=spec.norm,
                label=spec.label,
                place=scenario.place("metrics", name),
            )
        )
    return found
