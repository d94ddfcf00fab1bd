"""The dynamic feedback: passivity, gains that degenerate, gravity, and what follows from gains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf, isfinite, nan

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.checks import Finding
from cosim.predict import closed_form as closed
from cosim.predict.facts import Arm, DynamicFeedback, Law, SpringDamper
from cosim.predict.network import RobotNetwork, network, spread
from cosim.predict.system import AnalyzedSystem

#: Torques of gravity that are this close are compensated, N.m.
COMPENSATED = 1e-3


def known_laws(system: AnalyzedSystem) -> Iterator[tuple[str, Law, Arm]]:
    """All controllers whose law and arm are known."""
    for arm, name in sorted(system.controls.items()):
        law = system.facts.get(name)
        if isinstance(law, SpringDamper) or (isinstance(law, DynamicFeedback) and law.K):
            yield name, law, system.arms[arm]


def dynamic(system: AnalyzedSystem) -> Iterator[tuple[str, DynamicFeedback, Arm]]:
    """Controllers of this law, with their arms."""
    for name, law, arm in known_laws(system):
        if isinstance(law, DynamicFeedback):
            yield name, law, arm


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
            closed_form = law.task is None and not (law.lambda_c or law.beyond)
            joints = closed_form and min(law.K, default=0.0) > 0
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
    """O4 and O5 of an arm that is held: felt damping and stiffness."""
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


def _note(rule: str, where: str, number: float, unit: str, reason: str) -> Finding:
    return Finding(rule=rule, severity="note", where=where, number=number, unit=unit, reason=reason)
