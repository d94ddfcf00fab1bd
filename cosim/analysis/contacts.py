"""Numbers of the port by stiff grips and walls, and the passivity that they need."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, isinf

import numpy as np

from cosim.analysis.conditions import constant
from cosim.analysis.experiments import APART, RESOLVED, Bench, stiffest
from cosim.analysis.force_tests import each_feedback, title_of
from cosim.analysis.quantity import Quantity, absent, quantity
from cosim.base.errors import CosimError
from cosim.predict import closed_form as closed
from cosim.predict.network import RobotNetwork
from cosim.predict.passivity import passive_range, worst_posture

#: Length of runs with a wall and a grip, s.
WALL, GRIP = 60.0, 30.0
#: A wall that is neither soft nor stiff, N.m/rad.
MODERATE = 200.0
#: What is said where everything tried is stable.
RESOLVES = f"at least: the arm's step does not resolve stiffer ones (hω = {RESOLVED:g})"


def margin(bench: Bench) -> Iterator[Quantity]:
    """O9: how far lambda_M is inside the passive range, here and in the worst posture."""
    net = bench.network
    if net is None or bench.arm is None or not net.law.lambda_M:
        return
    here, worst = (passive_range(net, q) for q in (bench.q, worst_posture(net)[0]))
    for name, where, known in (("margin", "here", here), ("margin_worst", "worst posture", worst)):
        value = known.margin(net.law.lambda_M)
        yield quantity(
            name, f"passivity margin, {where}", value, "1/s", f"O9: {_limit_formula(net)}",
            note="passive" if value >= 0 else "below 0: not passive once M_hat = M",
        )  # fmt: skip


def _limit_formula(net: RobotNetwork) -> str:
    """The formula of the passive limit less lambda_M."""
    friction = ", K with the friction" if any(net.arms[net.port].damping) else ""
    alone = "α + λ_c" if net.law.lambda_c else "α + λ_min(K M⁻¹)"
    remark = " (Remark 3)" if net.law.lambda_c else ""
    if not net.around[net.port]:
        return f"{alone} - λ_M{friction}{remark}"
    return f"{alone} + λΣw less what echoes take - λ_M{friction}{remark}"


def grip_error(bench: Bench) -> float:
    """Uncertainty of a stiffest grip, as a share: the last step of the bisection, or the links.

    Where delays or weights vary, whether an oscillation grows is a matter of chance near the limit.
    """
    net = bench.network
    return 0.05 if net is None or constant(bench.system, net) else 0.15


def by_grip(bench: Bench) -> Iterator[Quantity]:
    """The stiffest undamped grip that the arm at the port stands."""
    tag, apart = title_of(bench), 1e-3 if bench.known else APART
    label, name = f"stiffest grip, {tag}", f"grip_{'known' if bench.known else 'started'}"
    how = f"k_p by bisection, k_d = 0, {GRIP:g} s each, gripped {apart:g} rad away, not to swing up"
    try:
        most = bench.greatest_stiffness(bench.port.arm)
        found = stiffest(
            lambda k: bench.does_not_grow(bench.grip(k, 0.0, apart, GRIP), (bench.port.rate,)), most
        )
    except CosimError as error:
        yield absent(name, label, "N.m/rad", how, str(error))
        return
    net = bench.network
    expected: float | tuple[()] = ()
    if net is not None and bench.known:
        expected = closed.stiffest_network_grip(net, bench.q)
    yield quantity(
        name, label, min(found, most), "N.m/rad", how, expected=expected,
        error=0.0 if isinf(found) else grip_error(bench) * found,
        formula="where det(1 + k_p G(jω)) = 0, not sampled" if expected != () else "",
        note=RESOLVES if isinf(found) else "",
    )  # fmt: skip


def by_wall(bench: Bench, felt: float) -> Iterator[Quantity]:
    """Static reflection O5 at a moderate wall, and Z-width: from `felt` (N.m.s/rad) to a wall."""
    port = bench.port
    if not port.far_force or not port.far_response:
        return
    how = f"far arm against a wall of {MODERATE:g} N.m/rad for {WALL:g} s"
    try:
        signals = (port.force, port.response, port.far_force, port.far_response)
        run = bench.run(bench.wall(MODERATE, WALL), signals)
    except CosimError as error:
        yield absent("stiffness", "static stiffness", "N.m/rad", how, str(error))
        return
    force, q, far_force, far_q = (run.array(name)[-1] for name in signals)
    ends = np.abs(np.array([force, far_force]))
    if not (ends.min(axis=1) > 1e-3 * ends.max()).all():
        why = "what the hand does does not get to the wall, or the wall's torque not to the hand"
        yield absent("stiffness", "static stiffness", "N.m/rad", how, why)
        return
    edge = _edge(bench)
    net = bench.network
    expected: list[float] = []
    if net is not None:
        expected = [closed.static_stiffness(net.law, edge, k) for k in each_feedback(net, len(q))]
    yield quantity(
        "stiffness", "static stiffness", force / (q - far_q), "N.m/rad",
        f"{how}: torque over q1 - q2 at the end", expected=expected, formula="O5, κ = λαK/λ_M",
    )  # fmt: skip
    yield quantity(
        "reflection", "static reflection", far_force / force, "1",
        f"{how}: torque on the wall over torque of the hand", expected=1.0, formula="Theorem 5",
    )  # fmt: skip
    yield from _z_width(bench, felt)


def _edge(bench: Bench) -> float:
    """Weight of the signals that the controller at the port receives."""
    return bench.system.received_weight(bench.system.controls.get(bench.port.arm, ""))


def _z_width(bench: Bench, felt: float) -> Iterator[Quantity]:
    port = bench.port
    how = f"k_w by bisection, {WALL:g} s each: the stiffest wall at the far arm that is at rest"
    try:
        most = bench.greatest_stiffness(port.far)
        rates = tuple(name for name in (port.rate, port.far_rate) if name)
        found = stiffest(lambda k: bench.decays(bench.wall(k, WALL), rates), most)
    except CosimError as error:
        yield absent("z_width", "Z-width", "N.m/rad", how, str(error))
        return
    free = f"{felt:.4g} N.m.s/rad" if isfinite(felt) else "no end of damping"
    note = f"free: {free}" + (f"; {RESOLVES}" if isinf(found) else "")
    wall = min(found, most)
    yield quantity("z_width", "Z-width: stiffest wall", wall, "N.m/rad", how, note=note)
