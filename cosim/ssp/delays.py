"""Links as small FMUs, which ``cosim export --links fmu`` puts between sender and receiver.

The FMU contains the rows of the link's table. A Jacobi master, in which all components read the
previous step, then gives the receiver in step k the sample that the link holds at its hit k.
"""

from __future__ import annotations

from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.base.parts import part
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Link
from cosim.schedule.plan import Plan


def build_delays(
    scenario: Scenario, plan: Plan, folder: Path, *, rates: bool = False
) -> dict[str, Path]:
    """Build an FMU into `folder` for each link of a plan; return them by the link's name.

    With `rates` it steps with the common period of its two ends; without, all components step in
    every tick. Raises ScenarioError for other links, and for a delay below one step.
    """
    model = part("link_delays")
    delays = []
    for i, link in enumerate(plan.links):
        _check(scenario, plan, link, rates)
        period = plan.component(link.target.component).period
        hits = -(-plan.ticks // period)
        rows = link.table.stream(hits).rows(hits)
        delays.append(
            model.LinkDelay(
                identifier=f"delay_{i + 1}",
                rows=rows.tolist(),
                history=link.table.history,
                width=link.target.size,
                unit=link.target.unit,
                step=period * plan.h,
                initial=link.initial,
            )
        )
    built = model.build_links(delays, folder)
    names = [link.name for link in plan.links]
    return dict(zip(names, [built[delay.identifier] for delay in delays], strict=True))


def _check(scenario: Scenario, plan: Plan, link: Link, rates: bool) -> None:
    ends = [plan.component(x.component).period for x in (link.source, link.target)]
    if rates and ends[0] != ends[1]:
        raise ScenarioError(
            f"its ends step every {ends[0]} and every {ends[1]} ticks; expected equal periods, "
            "because the delay is counted in periods",
            scenario.place("links", link.name),
        )
    for name in (link.source.component, link.target.component):
        if not rates and plan.component(name).period != 1:
            raise ScenarioError(
                f"{name} steps every {plan.component(name).period} ticks; other tools step every "
                "FMU in every step, so a delay FMU needs components that step in every tick "
                "(leave out the period, or set run.step to it)",
                scenario.place("links", link.name),
            )
    if link.table.minimum_delay_ticks < 1:
        raise ScenarioError(
            "can deliver a sample in the tick in which it was sent; expected a delay of at least "
            f"one step ({plan.h:g} s)",
            scenario.place("links", link.name),
        )
