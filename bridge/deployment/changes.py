"""Changes of a deployment as settings: other interfaces of its buses, another clock."""

from __future__ import annotations

from bridge.deployment.spec import Deployment
from cosim.base.errors import ScenarioError


def interface_settings(
    deployment: Deployment, interface: str | None, *, channels: bool = True
) -> list[str]:
    """The settings that give all CAN buses an interface of python-can; None: they keep theirs.

    `channels`: the channel of a bus whose interface changes is called like the bus.
    """
    found = []
    for name, bus in deployment.buses.items():
        if bus.kind != "can" or interface is None:
            continue
        found.append(f'deploy.buses.{name}.interface="{interface}"')
        if interface != bus.interface and channels:
            found.append(f'deploy.buses.{name}.channel="{name}"')
    return found


def clock_settings(deployment: Deployment, clock: str) -> list[str]:
    """The changes of a deployment for a clock other than the wall's. Raises ScenarioError."""
    if clock == "wall":
        return []
    if clock == "simulated":
        return ['deploy.clock="simulated"']
    if clock != "lockstep":
        raise ScenarioError(f"--clock {clock}: expected wall, simulated or lockstep")
    can = [name for name, bus in deployment.buses.items() if bus.kind == "can"]
    if can:
        raise ScenarioError(
            f"--clock lockstep: {', '.join(can)} is CAN, which may lose frames; expected a "
            "deployment over Zenoh alone",
            str(deployment.path),
        )
    return [f"deploy.buses.{name}.options.lockstep=true" for name in deployment.buses]
