"""The conditions under which O6 bounds M^t of a run, and those that a scenario breaks.

O6 is a gain from the force at the port to the position there, of robots that know their parameters
and start together at rest: then the response without the force is 0. It says nothing of a run in
which robots move by themselves, because they start apart, or because something else pushes them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cosim.predict.facts import Arm, DynamicFeedback
from cosim.predict.inputs import is_driven
from cosim.predict.network import RobotNetwork
from cosim.predict.system import AnalyzedSystem, values_of
from cosim.scenario.connect import EdgeWeight


def unmet_conditions(system: AnalyzedSystem, net: RobotNetwork) -> tuple[str, ...]:
    """The conditions of O6 that a scenario does not meet, as phrases with the values found."""
    return tuple(_unmet_conditions(system, net))


def _unmet_conditions(system: AnalyzedSystem, net: RobotNetwork) -> Iterator[str]:
    names = [system.arm_of(law) or "" for law in net.names]
    values = [values_of(system.plan.component(name)) for name in names]
    dq = np.array([v.get(arm.rate, (0.0,)) for v, arm in zip(values, net.arms, strict=True)])
    q = np.array([arm.q for arm in net.arms])
    alpha = np.array([[law.alpha] for law in net.laws])
    apart = float(np.ptp(dq + alpha * q, axis=0).max())
    if apart > 1e-12:
        yield f"equal ξ_i(0), found {apart:.4g} rad/s apart"
    if dq.any() or any(any(law.z) for law in net.laws):
        yield "dq(0) = z(0) = 0"
    if not all(_known(arm, law) for arm, law in zip(net.arms, net.laws, strict=True)):
        yield "θ known, found theta_hat that is not θ or adapts"
    if any(
        any(arm.gravity) and law.gravity != "compensated"
        for arm, law in zip(net.arms, net.laws, strict=True)
    ):
        yield "no gravity, or gravity compensated"
    others = [name for i, name in enumerate(names) if i != net.port and _pushed(system, name)]
    if others:
        yield f"no other force, found one on {', '.join(others)}"
    if not constant(system, net):
        yield "delays and weights that are constant"
    if net.outside.any():
        yield "neighbours that are known robots"


def constant(system: AnalyzedSystem, net: RobotNetwork) -> bool:
    """True if delays and weights stay as they are: else a frequency response is one on average."""
    switching = any(
        isinstance(p.source, EdgeWeight) and len(p.source.topology.graphs) > 1
        for p in system.plan.players
    )
    return not switching and not any(age.spread for age in net.couplings.ages)


def _known(arm: Arm, law: DynamicFeedback) -> bool:
    """True if the law has the true parameters and keeps them."""
    true = (*arm.parameters, *arm.gravity)[: len(law.theta_hat)]
    return not any(law.Gamma) and bool(np.allclose(law.theta_hat, true, rtol=1e-9, atol=0))


def _pushed(system: AnalyzedSystem, name: str) -> bool:
    """True if a grip, a wall or another component acts on an arm."""
    arm = system.arms[name]
    inside = arm.grip.is_present or any(arm.wall.stiffness) or any(arm.wall.damping)
    return inside or is_driven(system.plan, f"{name}.{arm.external}")
