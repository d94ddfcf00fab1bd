"""The figures a scenario declares."""

from __future__ import annotations

from collections.abc import Mapping

from cosim.record import Run
from cosim.reporting.arms import curve_colours, first_arms, owners
from cosim.reporting.figures import Figure, Panel
from cosim.reporting.marks import failure, marks
from cosim.scenario.spec import PanelSpec, Scenario


def figure_specs(scenario: Scenario, run: Run) -> dict[str, Figure]:
    """The scenario's figures, by name, with the events of a run and how it failed.

    Colours are those of the arms in the report, as there.
    """
    facts = run.metadata
    arms, _ = first_arms(run)
    of = owners([arm.name for arm in arms], facts)
    return {
        name: Figure(
            title=spec.title or scenario.title,
            events=tuple(marks(facts)),
            failure=failure(facts),
            panels=tuple(_panel(p, run, of) for p in spec.panels),
        )
        for name, spec in scenario.figures.items()
    }


def _panel(spec: PanelSpec, run: Run, of: Mapping[str, int]) -> Panel:
    lines = [entry for name in spec.y if run.has(name) for entry in run.entries(name)]
    return Panel(
        y=spec.y, title=spec.title, labels=spec.labels, reference=spec.reference,
        reference_label=spec.reference_label, ylabel=spec.ylabel, colours=curve_colours(lines, of),
    )  # fmt: skip
