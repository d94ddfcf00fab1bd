"""Sampled data: checks of the period against the feedback, the estimate and the hands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from cosim.checks import Finding, Severity
from cosim.checks.peaks import held_networks
from cosim.predict.facts import Arm, DynamicFeedback, Hand, Law, SpringDamper
from cosim.predict.network import spread
from cosim.predict.system import AnalyzedSystem

#: Stability limit of the classical Runge-Kutta method: h times a frequency, h times a decay.
RK4 = 2.8
#: Share of a bound from which on it is worth a warning.
CLOSE = 0.7


def known_laws(system: AnalyzedSystem) -> Iterator[tuple[str, Law, Arm]]:
    """All controllers whose law and arm are known."""
    for arm, name in sorted(system.controls.items()):
        law = system.facts.get(name)
        if isinstance(law, SpringDamper) or (isinstance(law, DynamicFeedback) and law.K):
            yield name, law, system.arms[arm]


def feedback(system: AnalyzedSystem) -> Iterator[Finding]:
    """T_s lambda_max(K) < 2 lambda_min(M): a held torque -K dq must not overshoot.

    This follows from M (dq⁺ - dq) = -T_s K dq; the limit is half of that if all components use
    values of the previous tick (jacobi). An error if it fails at the start or at the target of the
    hand, a warning if it fails elsewhere.
    """
    share = 1.0 if system.plan.algorithm == "jacobi" else 2.0
    known = [found for found in known_laws(system) if not _depends_on_posture(found[1])]
    visited = _fastest_when_visited(known)
    for name, law, arm in known:
        T, remark3 = system.feedback_period(name), _is_remark_3(law)
        gain = law.lambda_c if remark3 else max(law.feedback)  # type: ignore[union-attr]
        if not gain:
            continue
        least, joint = 1.0, 0
        if not remark3:
            rate, joint = arm.fastest(law.feedback)
            gain = law.feedback[joint % len(law.feedback)]
            least = gain / rate
        ratio = T * gain / (share * least)
        fails = share < T * (gain if remark3 else visited[name])
        severity: Severity = "error" if fails else "warning" if ratio > CLOSE else "note"
        many = arm.workspace is not None and not remark3
        what = "lambda_c" if remark3 else f"K of joint {joint + 1}" if many else "K"
        inertia = f"{share:g} times its inertia" if many else f"{share:g} λ_min(M)"
        bound = "2" if remark3 else f"{inertia} = {share * least:.3g} kg.m2"
        posture = "" if remark3 else " in the lightest posture"
        yield Finding(
            rule="sampling",
            severity=severity,
            where=name,
            number=ratio,
            unit="1",
            reason=f"T_s {what} = {T:g} s · {gain:g} is {ratio * 100:.0f} % of {bound}{posture}"
            + (", and exceeds it in a posture at the start or the goal" if fails else ""),
            advice="" if severity == "note"
            else f"sample every {0.5 * share * least / gain * 1e3:.2g} ms, or lower {what}",
        )  # fmt: skip


def _depends_on_posture(law: Law) -> bool:
    """True if its gain does: cosim.checks.tasks has the rule for those."""
    return isinstance(law, DynamicFeedback) and law.task is not None and not law.lambda_c


def _is_remark_3(law: Law) -> bool:
    return isinstance(law, DynamicFeedback) and law.lambda_c > 0


def _fastest_when_visited(known: Iterable[tuple[str, Law, Arm]]) -> Mapping[str, float]:
    """The greatest eigenvalue of M⁻¹ K in the postures that an arm is expected in, 1/s, by law."""
    found: dict[str, float] = {}
    cases: dict[int, list[tuple[str, Law, Arm, Sequence[float]]]] = {}  # by number of joints
    for name, law, arm in known:
        for q in _postures(arm) if not _is_remark_3(law) else ():
            cases.setdefault(len(q), []).append((name, law, arm, q))
    for m, alike in cases.items():
        inverse = np.linalg.inv([arm.inertia(arm.parameters, q) for _, _, arm, q in alike])
        K = np.array([spread(law.feedback, m) for _, law, _, _ in alike])
        rates = np.linalg.eigvals(inverse * K[:, None]).real.max(axis=-1)
        for (name, *_), rate in zip(alike, rates.tolist(), strict=True):
            found[name] = max(rate, found.get(name, rate))
    return found


def _postures(arm: Arm) -> list[Sequence[float]]:
    """Expected postures of an arm: its start position and the target of its hand."""
    return [arm.q, arm.grip.place] if any(arm.grip.stiffness) else [arm.q]


def adaptation(system: AnalyzedSystem) -> Iterator[Finding]:
    """T_s Γ ‖Y‖² < lambda_min(K): the estimate must not outrun the damping of s.

    From s⁺ = s - T_s/M (K s + Y θ̃), θ̃⁺ = θ̃ + T_s Γ Yᵀ s with Y frozen: stable iff
    T_s Γ ‖Y‖² < K (and T_s K < 2 M). ‖Y‖ is estimated from how fast z will change.
    """
    for net, found in held_networks(system):
        for i, (name, law) in enumerate(zip(net.names, net.laws, strict=True)):
            T, Y = system.period(name), law.regressor * found.dz[i]
            if not min(law.K) > 0:
                yield _undamped(name, min(law.K))
                continue
            ratio = T * max(law.Gamma) * Y**2 / min(law.K)
            severity: Severity = "warning" if ratio > 1 else "note"
            if ratio < 0.25:
                continue
            yield Finding(
                rule="adaptation",
                severity=severity,
                where=name,
                number=float(ratio),
                unit="1",
                reason=f"T_s Γ ‖Y‖² is about {ratio * 100:.0f} % of λ_min(K) = {min(law.K):g}, with"
                f" ‖Y‖ about {Y:.2g} while it moves fastest (an estimate, to a factor of 2)",
                advice="" if severity == "note"
                else f"lower {law.adaptation} to {max(law.Gamma) / ratio / 2:.2g} or sample faster",
            )  # fmt: skip


def _undamped(name: str, least: float) -> Finding:
    """The finding for a law without damping of s, which the estimate outruns at any step."""
    return Finding(
        rule="adaptation",
        severity="warning",
        where=name,
        number=float(least),
        unit="N.m.s/rad",
        reason=f"λ_min(K) = {least:g}, so nothing damps s while the estimate adapts",
        advice="raise K in every joint",
    )


def contact(system: AnalyzedSystem) -> Iterator[Finding]:
    """Grips and walls inside an arm against the step of its integrator."""
    for name, arm in sorted(system.arms.items()):
        h = system.period(name) * arm.h_max
        least = arm.inertia_range[0]
        for what, spring in (("grip", arm.grip), ("wall", arm.wall)):
            if not spring.is_present:
                continue
            k, b = max(spring.stiffness), max(spring.damping)
            number = max(h * arm.fastest(spring.stiffness)[0] ** 0.5,
                         h * arm.fastest(spring.damping)[0])  # fmt: skip
            if number <= 1.0:
                continue
            severity: Severity = "error" if number > RK4 else "warning"
            yield Finding(
                rule="contact",
                severity=severity,
                where=name,
                number=number,
                unit="1",
                reason=f"{what} of {k:g} N.m/rad, {b:g} N.m.s/rad on {least:.3g} kg.m2: h ω ="
                f" {number:.2g} for steps of {h:g} s (inaccurate above 1, unstable above {RK4:g})",
                advice=f"set {int(np.ceil(number / arm.h_max / 0.5))} substeps for {name}",
            )


def sampled_hand(system: AnalyzedSystem) -> Iterator[Finding]:
    """A sampled hand: its spring makes energy that damping must take, k_p T/2 < k_d + K."""
    for wire in system.plan.wires:
        spring = system.facts.get(wire.source.component)
        arm = system.arms.get(wire.target.component)
        if not isinstance(spring, Hand) or arm is None or wire.target.port != arm.external:
            continue
        T = system.period(wire.source.component)
        law = system.facts.get(system.controls.get(wire.target.component, ""))
        known = isinstance(law, SpringDamper) or (isinstance(law, DynamicFeedback) and law.K)
        damping = spread(law.feedback if known else (0.0,), len(arm.q))  # type: ignore[union-attr]
        k_d, m = max(spring.damping), len(arm.q)
        energy, braked = spread(spring.stiffness, m) * T / 2, spread(spring.damping, m) + damping
        joint = int(np.argmax(energy - braked))
        makes, takes = float(energy[joint]), float(braked[joint])
        overshoots = T * arm.fastest(spring.damping)[0] > 2
        if makes < takes and not overshoots:
            continue
        reason = f"k_p T/2 = {makes:.3g} N.m.s/rad is not below the damping, {takes:.3g}"
        if overshoots:
            reason = (
                f"T k_d = {T * k_d:.3g} kg.m2 is above 2 λ_min(M) = {2 * arm.inertia_range[0]:.3g}"
            )
        yield Finding(
            rule="hand",
            severity="error" if overshoots else "warning",
            where=wire.source.component,
            number=makes,
            unit="N.m.s/rad",
            reason=f"sampled every {T:g} s, {reason}",
            advice="use the grip inside the plant, which its solver integrates, or sample faster",
        )
