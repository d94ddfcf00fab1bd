"""Robots that take positions or velocities: what their servos make of a law."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cosim.checks import Finding, Severity
from cosim.predict.facts import Arm, DynamicFeedback, Servo, ServoCommand
from cosim.predict.network import spread
from cosim.predict.system import AnalyzedSystem, CommandPath

#: What a law says that is moved by a measured torque.
MEASURED = "it is moved by a measured torque"
#: Shares of a joint's inertia by which it may seem heavier, without a word and without a warning.
LITTLE, MUCH = 0.1, 0.5
#: How many times as fast as the coupling a servo must be, at least and to be on the safe side.
FAST, SAFE = 5.0, 10.0


def _commanded(system: AnalyzedSystem) -> Iterator[tuple[CommandPath, Arm, Servo]]:
    """Arms with servos, and how they are commanded."""
    for arm, command in sorted(system.commands.items()):
        servo = system.facts[command.servo]
        assert isinstance(servo, Servo)
        yield command, system.arms[arm], servo


def gains(system: AnalyzedSystem) -> Iterator[Finding]:
    """A component that turns torques into commands must know the servo: mode, gains and period."""
    for command, _, servo in _commanded(system):
        turned = system.facts.get(command.by)
        if not isinstance(turned, ServoCommand):
            continue
        T, wrong = system.period(command.by), []
        if turned.servo.by_position != servo.by_position:
            wrong.append("mode")
        if turned.servo.feed_forward != servo.feed_forward:
            wrong.append("feed_forward")
        wrong += [name for name in ("K_v", "K_p") if _differ(turned.servo, servo, name)]
        if servo.by_position and abs(servo.T_c - T) > 1e-9:
            wrong.append(f"the period ({T:g} s; T_c = {servo.T_c:g} s)")
        if wrong:
            yield Finding(
                rule="servo-gains",
                severity="warning",
                where=command.by,
                number=float(len(wrong)),
                unit="1",
                reason=f"it does not know the servo {command.servo} as it is: {', '.join(wrong)}"
                " differ, and so do torques from those that are wanted",
                advice="give it the parameters of the servo",
            )


def _differ(a: Servo, b: Servo, name: str) -> bool:
    m = max(len(getattr(a, name)), len(getattr(b, name)))
    return not np.allclose(spread(getattr(a, name), m), spread(getattr(b, name), m))


def inertia(system: AnalyzedSystem) -> Iterator[Finding]:
    """The servo's resistance until the next command, against the inertia of a joint.

    Under a constant torque it seems K_v T (1 + exp(K_v d/M)/(exp(K_v T/M) - 1)) instead of M, for
    commands every T that are d <= T late, and K_v T more for each further T.
    """
    for command, arm, servo in _commanded(system):
        if command.direct:
            continue
        T = system.period(command.by)
        late = system.age(command.link).mean if command.link is not None else 0.0
        M = np.diag(arm.inertia(arm.parameters, arm.q))
        K_v = spread(servo.K_v, len(M))
        whole, rest = divmod(late, T)
        x = np.maximum(K_v * T / M, 1e-9)
        more = x * (1 + whole + np.exp(x * (rest / T - 1)) / -np.expm1(-x)) - 1
        joint = int(np.argmax(more))
        if more[joint] <= LITTLE:
            continue
        severity: Severity = "warning" if more[joint] > MUCH else "note"
        yield Finding(
            rule="servo-inertia",
            severity=severity,
            where=command.by,
            number=float(more[joint]),
            unit="1",
            reason=f"commanded every {T:g} s, joint {joint + 1} seems {more[joint] * 100:.0f} %"
            f" heavier: K_v = {K_v[joint]:g} N.m.s/rad resists what is not commanded yet, its"
            f" inertia is {M[joint]:.3g} kg.m2",
            advice="command it faster, or with a smaller K_v" if severity == "warning" else "",
        )


def torque(system: AnalyzedSystem) -> Iterator[Finding]:
    """The torque that a velocity mode can give: K_v v_max at rest, or what an integral kept."""
    for command, arm, servo in _commanded(system):
        if command.direct or servo.by_position:
            continue
        if any(servo.K_p):
            yield Finding(
                rule="servo-integral",
                severity="warning",
                where=command.servo,
                number=max(servo.K_p),
                unit="N.m/rad",
                reason="its integral is not known after a limit has acted: what is missing stays as"
                " a constant torque, and coupled arms stay apart",
                advice="use its position mode, or a velocity mode without integral",
            )
            continue
        if arm.weight is None:
            continue
        m = len(arm.q)
        most = spread(servo.K_v, m) * spread(servo.v_max, m)
        weight = np.abs(arm.weight(arm.gravity, arm.q))
        joint = int(np.argmax(weight / np.maximum(most, 1e-12)))
        if weight[joint] > most[joint]:
            yield Finding(
                rule="servo-torque",
                severity="warning",
                where=command.servo,
                number=float(most[joint]),
                unit="N.m",
                reason=f"at rest it gives K_v v_max = {most[joint]:.3g} N.m at most; joint"
                f" {joint + 1} needs {weight[joint]:.3g} N.m against gravity where it starts",
                advice="use its position mode, or let the robot compensate gravity",
            )


def bandwidth(system: AnalyzedSystem) -> Iterator[Finding]:
    """A servo whose command is the coupling itself must be fast against it."""
    for command, arm, servo in _commanded(system):
        law = system.facts.get(command.law)
        if not command.direct or not isinstance(law, DynamicFeedback) or law.feeds_forward:
            continue
        rate, joint = _rate(arm, servo)
        heard = system.received_weight(command.law)
        coupling = law.alpha + max(law.lambda_ * heard, law.lambda_M)
        late = 1 / rate if rate else float("inf")
        ratio = rate / coupling if coupling else float("inf")
        severity: Severity = "warning" if ratio < FAST else "note"
        yield Finding(
            rule="servo-bandwidth",
            severity=severity,
            where=command.law,
            number=ratio,
            unit="1",
            reason=f"the servo of joint {joint + 1} follows at {rate:.3g} 1/s where it is slowest,"
            f" {ratio:.2g} times the rate of the coupling ({coupling:.3g} 1/s);"
            f" its delay of {late:.2g} s counts as part of T",
            advice="" if ratio >= SAFE
            else f"{SAFE:g} times are safe: raise the servo's gains, or lower lambda_M and lambda",
        )  # fmt: skip


def _rate(arm: Arm, servo: Servo) -> tuple[float, int]:
    """The slowest rate at which a servo follows its command, 1/s, and the joint."""
    velocity, joint, _ = arm.slowest(servo.K_v)
    if not servo.by_position:
        return velocity, joint
    m = len(arm.q)
    K_p, K_v = spread(servo.K_p, m), spread(servo.K_v, m)
    if servo.feed_forward == 1.0 and (K_p < K_v * velocity).all():
        return velocity, joint
    each = np.where(K_v > 0, K_p / np.maximum(K_v, 1e-12), np.inf)
    return min(velocity, float(each.min())), int(np.argmin(each))


def holding(system: AnalyzedSystem) -> Iterator[Finding]:
    """A servo that keeps its position, under a law that lets a push move the arm."""
    held = set(system.held())
    for name, command in sorted(system.commands.items()):
        servo, law = system.facts[command.servo], system.facts.get(command.law)
        if not command.direct or not isinstance(law, DynamicFeedback) or name not in held:
            continue
        assert isinstance(servo, Servo)
        if not (any(servo.K_p) or servo.by_position) or law.beyond == MEASURED:
            continue
        yield Finding(
            rule="servo-holds",
            severity="warning",
            where=command.servo,
            number=max(servo.K_p),
            unit="N.m/rad",
            reason=f"it holds the commanded position with {max(servo.K_p):g} N.m/rad: who pushes"
            " the arm does not move it",
            advice="use a velocity mode without integral, or measure the torque (tau_m and b)",
        )
