"""The dynamic feedback: passivity, gains that degenerate, gravity, and what follows from gains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, isfinite, log, nan

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.checks import Finding, Severity
from cosim.checks.peaks import settling
from cosim.checks.sampling import known_laws
from cosim.predict import closed_form as closed
from cosim.predict.facts import Arm, DynamicFeedback
from cosim.predict.network import RobotNetwork, network, spread
from cosim.predict.passivity import PassiveRange, is_passive, passive_range, worst_posture
from cosim.predict.system import AnalyzedSystem

#: Torques of gravity that are this close are compensated, N.m.
COMPENSATED = 1e-3


def dynamic(system: AnalyzedSystem) -> Iterator[tuple[str, DynamicFeedback, Arm]]:
    """Controllers of this law, with their arms."""
    for name, law, arm in known_laws(system):
        if isinstance(law, DynamicFeedback):
            yield name, law, arm


def passivity(system: AnalyzedSystem) -> Iterator[Finding]:
    """O9: lambda_M <= alpha + lambda_min(K M⁻¹), or alpha + lambda_c, in the heaviest posture.

    Of coupled robots it is the limit of the whole network at this port.
    """
    for name, law, arm in dynamic(system):
        if law.task is not None and not law.lambda_c:
            continue  # its gain depends on the posture: checks.tasks
        if law.beyond or not law.feeds_forward:
            continue  # without M_hat it is passive
        found = _not_passive(system, name, law, arm)
        if found is None:
            continue
        known, joint = found
        many = arm.workspace is not None and not law.lambda_c
        least = f", least for joint {joint + 1}" if many else ""
        above = known.limit < law.lambda_M
        limit = known.limit if above else known.least
        cures = ", raise K, or use lambda_c (Remark 3)" if not law.lambda_c and above else ""
        yield Finding(
            rule="passivity",
            severity="warning",
            where=name,
            number=known.margin(law.lambda_M),
            unit="1/s",
            reason=f"lambda_M = {law.lambda_M:g} 1/s is {'above' if above else 'below'} the passive"
            f" limit {limit:.3g} 1/s (exact estimates, heaviest posture{least}): oscillations with"
            " a stiff grip or contact can grow",
            advice=f"{'lower' if above else 'raise'} lambda_M to {limit:.3g}{cures}",
        )


def _not_passive(
    system: AnalyzedSystem, name: str, law: DynamicFeedback, arm: Arm
) -> tuple[PassiveRange, int] | None:
    """The passive range of a law outside it, in the worst posture, and the joint that limits it.

    Of laws that are coupled in a way that no network describes, the limit for a fast hand.
    """
    port = next(each for each, control in system.controls.items() if control == name)
    net = network(system, port)
    if net is not None and net.around[net.port]:
        posture, joint = worst_posture(net)
        return None if is_passive(net, posture) else (passive_range(net, posture), joint)
    alone, joint = closed.worst_passive_limit(law, arm)
    limit = alone + law.lambda_ * system.received_weight(name)
    return None if law.lambda_M <= limit else (PassiveRange(0.0, limit), joint)


def grip(system: AnalyzedSystem) -> Iterator[Finding]:
    """The scenario's own grip, theta known: where det(1 + (k_p + k_d jω) G) would reach 0.

    Only looked into where one arm alone fails by Routh. An error at the start, a warning elsewhere.
    """
    for start in system.held():
        net = network(system, start)
        if net is None or net.law.lambda_c or not min(net.arms[net.port].grip.stiffness):
            continue
        arm, law = net.arms[net.port], net.law
        if not law.feeds_forward or len(net.laws) * len(arm.q) > closed.MANY:
            continue  # without M_hat it is stable; many robots would take minutes
        stiffness, damping = arm.grip.stiffness, arm.grip.damping
        k_p, k_d = max(stiffness), min(damping)
        failing = [
            q for q in (arm.q, arm.heaviest)
            if not all(closed.grip_stable(law, float(M), min(law.K), k_p, k_d)
                       for M in np.linalg.eigvalsh(arm.inertia(arm.parameters, q)))
            and closed.stiffest_network_grip(net, q, stiffness, damping, 300) < 1.0
        ]  # fmt: skip
        if not failing:
            continue
        starts = failing[0] == arm.q
        where = "where it starts" if starts else "in the heaviest posture"
        severity: Severity = "error" if starts else "warning"
        yield Finding(
            rule="grip",
            severity=severity,
            where=start,
            number=k_p,
            unit="N.m/rad",
            reason=f"with lambda_M = {law.lambda_M:g} 1/s a grip of {k_p:g} N.m/rad and {k_d:g}"
            f" N.m.s/rad is unstable {where} once the estimates are exact",
            advice="lower lambda_M, raise K, or use a softer grip (or more k_d)",
        )


def degenerate(system: AnalyzedSystem) -> Iterator[Finding]:
    """lambda_M = alpha and z(0) = 0 without neighbours: z stays 0, nothing adapts (finding 1)."""
    receivers = {e.receiver for e in system.edges if e.recurrent}
    for name, law, _ in dynamic(system):
        hears = law.lambda_ > 0 and name in receivers
        if law.lambda_M == law.alpha != 0 and not any(law.z) and not hears:
            yield Finding(
                rule="degenerate",
                severity="warning",
                where=name,
                number=law.lambda_M,
                unit="1/s",
                reason=f"lambda_M = alpha = {law.alpha:g} 1/s and z(0) = 0: z stays 0, no parameter"
                " is adapted, and the law is exactly tau = -K dq",
                advice="choose lambda_M above alpha (the paper's captions: 6)",
            )


def no_integral(system: AnalyzedSystem) -> Iterator[Finding]:
    """lambda_M = 0: no integral action, so the force must be held permanently."""
    for name, law, _ in dynamic(system):
        if law.lambda_M == 0 and law.alpha > 0:
            joints = law.task is None and not law.lambda_c and min(law.K, default=0.0) > 0
            gain = 1 / (law.alpha * min(law.K)) if joints else inf
            yield Finding(
                rule="no-integral",
                severity="warning",
                where=name,
                number=0.0,
                unit="1/s",
                reason="lambda_M = 0: degree 0, manipulability is finite"
                + (
                    f" (at most 1/(αK) = {gain:.3g} rad/(N.m) for one arm)"
                    if isfinite(gain)
                    else ""
                )
                + ", and the operator has to keep holding the arm",
                advice="choose lambda_M > 0 (Theorem 2)",
            )


def gravity(system: AnalyzedSystem) -> Iterator[Finding]:
    """Gravity that is adapted takes the manipulability away; gravity unknown makes arms sag."""
    for name, law, arm in known_laws(system):
        weight = max((abs(g) for g in arm.gravity), default=0.0)
        if isinstance(law, DynamicFeedback) and law.gravity == "adapted":
            yield Finding(
                rule="gravity",
                severity="warning",
                where=name,
                number=max(law.Gamma[3:], default=max(law.Gamma)),
                unit="1",
                reason="gravity is adapted: its estimate absorbs a constant external force, the arm"
                " stops although it is pushed, and reflected torques decay",
                advice="compensate it (gravity = 1, with the theta_g of the platform)",
            )
            continue
        adapts = isinstance(law, DynamicFeedback)
        knows = law.theta_g if not adapts or law.gravity == "compensated" else ()  # type: ignore[union-attr]
        if arm.weight is not None:
            yield from _weight(name, arm, knows or (0.0,) * len(arm.gravity))
        elif weight and tuple(knows) != tuple(arm.gravity):
            found = f"compensates {list(knows)}" if any(knows) else "compensates nothing"
            yield Finding(
                rule="gravity",
                severity="warning",
                where=name,
                number=weight,
                unit="N.m",
                reason=f"the arm has gravity {list(arm.gravity)} N.m, but the controller {found}:"
                " the arm sags",
                advice="compensate the arm's theta_g",
            )


def _weight(name: str, arm: Arm, knows: Sequence[float]) -> Iterator[Finding]:
    """The torque of gravity where the arm starts, against the one that is compensated."""
    assert arm.weight is not None
    missing = arm.weight(arm.gravity, arm.q) - arm.weight(knows, arm.q)
    joint = int(np.argmax(np.abs(missing)))
    torque = float(np.abs(missing).max())
    if torque <= COMPENSATED:
        return
    yield Finding(
        rule="gravity",
        severity="warning",
        where=name,
        number=torque,
        unit="N.m",
        reason=f"where the arm starts, gravity and what is compensated differ by {torque:.3g} N.m"
        f" at joint {joint + 1}: the arm sags, or coupled arms stay apart",
        advice="give the controller the arm's inertia and payload, and compensate gravity",
    )


# ---- what follows from the gains ----------------------------------------------------------------


def prediction(system: AnalyzedSystem) -> Iterator[Finding]:
    """O3, O4, O5 of whoever is held: felt damping, stiffness, slowest pole."""
    for start in system.held():
        net = network(system, start)
        if net is None or net.law.lambda_c:
            continue
        where, friction = start, net.arms[net.port].friction
        joints = list(zip(spread(net.law.K, len(friction)), friction, strict=True))
        try:
            each = {joint: closed.felt_damping(net, *joint) for joint in dict.fromkeys(joints)}
        except ScenarioError as error:  # without SciPy, of very many robots
            yield _note("felt-damping", where, nan, "N.m.s/rad", f"not computed: {error}")
            continue
        damping = [each[joint] for joint in joints]
        if all(isfinite(d) for d in damping):
            yield _note(
                "felt-damping",
                where,
                min(damping),
                "N.m.s/rad",
                f"a hand that moves it slowly will feel {_each(damping)} N.m.s/rad (O4)",
            )
        else:
            stiffness = [closed.felt_stiffness(net, K, D) for K, D in joints]
            yield _note(
                "felt-stiffness",
                where,
                min(stiffness),
                "N.m/rad",
                f"a hand will feel a spring of {_each(stiffness)} N.m/rad (O2)",
            )
        yield from _coupling(net, where, [K for K, _ in joints])
        yield from _pole(net, where)


def _each(values: Sequence[float]) -> str:
    """One number if all are alike, else that of each joint."""
    texts = [f"{x:.3g}" for x in values]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)


def _coupling(net: RobotNetwork, where: str, K: Sequence[float]) -> Iterator[Finding]:
    coupled = net.couplings.around(len(net.laws))[net.port]
    weight = coupled / net.law.lambda_ if net.law.lambda_ else 0.0
    if len(net.laws) == 2 and weight and net.law.lambda_M:
        kappa = [closed.static_stiffness(net.law, weight, k) for k in K]
        yield _note(
            "stiffness", where, min(kappa), "N.m/rad",
            f"at rest the arms are coupled by a spring of {_each(kappa)} N.m/rad (O5): a larger"
            " lambda_M is easier to move, and softer",
        )  # fmt: skip


def _pole(net: RobotNetwork, where: str) -> Iterator[Finding]:
    arm = net.arms[net.port]
    if not any(arm.grip.stiffness) or not net.law.lambda_M:
        return
    place = arm.grip.place
    roots = closed.poles(net, place, net.true_estimates(), arm.grip.stiffness, arm.grip.damping)
    if not len(roots) or roots[0].real >= 0:
        return
    rate = float(roots[0].real)
    away = float(np.abs(np.asarray(place) - np.asarray(arm.q)).max())
    text = f"the slowest pole with the hand is {rate:.3g} 1/s with exact estimates (O3)"
    if arm.workspace is not None:  # the pole is that of one joint, the error perhaps of another
        text += _settling(net)
    elif away > 0.05:
        soonest = log(away / 0.05) / -rate
        text += f"; the error is below 0.05 rad after {soonest:.2g} s at the earliest"
    yield _note("slow-pole", where, rate, "1/s", text)


def _settling(net: RobotNetwork) -> str:
    seconds = settling(net, 0.05)
    if not isfinite(seconds):
        return ""
    return (
        f"; every joint is within 0.05 rad of the hand after about {seconds:.2g} s (linear motion"
        " of each joint alone, without delays)"
    )


def _note(rule: str, where: str, number: float, unit: str, reason: str) -> Finding:
    return Finding(rule=rule, severity="note", where=where, number=number, unit=unit, reason=reason)
