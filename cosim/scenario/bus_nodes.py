"""The simulated CAN buses of a scenario that connect FMUs with CAN terminals (FMI-LS-BUS)."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import unknown
from cosim.scenario.spec import Scenario
from cosim.schedule.parts import Step


def connect_nodes(scenario: Scenario, steps: Sequence[Step]) -> None:
    """Put every component that names a bus on that bus. Raises ScenarioError.

    One bus has FMUs or links, not both, and no other traffic. Its FMUs are continuous and have one
    period.
    """
    groups: dict[str, list[Step]] = {}
    for step in steps:
        bus, place = scenario.components[step.name].bus, ("components", step.name, "bus")
        if not bus:
            continue
        if bus not in scenario.buses:
            raise ScenarioError(unknown(bus, scenario.buses, "bus"), scenario.place(*place))
        groups.setdefault(bus, []).append(step)
    for bus, members in groups.items():
        try:
            _check(scenario, bus, members)
            _connect(scenario, bus, members)
        except CosimError as error:
            raise ScenarioError(str(error), scenario.place("bus", bus)) from None


def _check(scenario: Scenario, bus: str, members: Sequence[Step]) -> None:
    names = ", ".join(m.name for m in members)
    if any(link.bus == bus for link in scenario.links):
        raise ScenarioError(
            f"found links on the bus of the FMUs {names}, expected another bus for the links"
        )
    if scenario.buses[bus].traffic:
        raise ScenarioError(f"found traffic on the bus of the FMUs {names}, expected none")
    others = sorted(set(scenario.buses[bus].nodes) - {m.name for m in members})
    if others:
        raise ScenarioError(f"found the nodes {', '.join(others)}, expected some of: {names}")
    if scenario.run.algorithm == "gauss-seidel":
        raise ScenarioError(
            'found algorithm = "gauss-seidel" with FMUs on a bus, expected "sampled" or "jacobi"'
        )
    periods = {m.period for m in members}
    if len(periods) > 1:
        raise ScenarioError(
            f"found the periods {sorted(periods)} (ticks) of {names}, expected one period"
        )


def _connect(scenario: Scenario, bus: str, members: Sequence[Step]) -> None:
    from cosim.bus.timing import BusTiming
    from cosim.lsbus.member import BusMember, IntegratedBus
    from cosim.scenario.bus_traffic import disturbances
    from cosim.scenario.buses import node_settings

    spec = scenario.buses[bus]
    for member in members:
        if scenario.components[member.name].kind == "sampled":
            raise ScenarioError(f"{member.name} is sampled, expected a continuous component")
    IntegratedBus(
        bus,
        BusTiming(spec.bitrate, spec.data_bitrate, spec.fd),
        [m.component for m in members if isinstance(m.component, BusMember)],
        disturbances=disturbances(scenario, bus, {m.name: i for i, m in enumerate(members)}),
        seed=scenario.run.seed,
        settings={m.name: node_settings(spec, m.name) for m in members},
    )
