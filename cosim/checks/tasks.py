"""Laws in the coordinates of a tip: sampling, passivity, singularities, and what arms lack."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from cosim.checks import Finding
from cosim.checks.laws import dynamic
from cosim.predict.facts import Arm, Array, DynamicFeedback, SpringDamper, TipContact, TipTask
from cosim.predict.network import spread
from cosim.predict.system import AnalyzedSystem, Edge


class _Tip(NamedTuple):
    """A controller of a tip, its task and its arm."""

    name: str
    law: DynamicFeedback
    task: TipTask
    arm: Arm


def _tips(system: AnalyzedSystem) -> Iterator[_Tip]:
    for name, law, arm in dynamic(system):
        if law.task is not None:
            yield _Tip(name, law, law.task, arm)


def _gain(tip: _Tip, q: Sequence[float]) -> Array:
    """The feedback of s with the friction of the joints, (m, m), N.m.s/rad."""
    return tip.task.feedback(q) + np.diag(tip.arm.friction)


def _rows(tip: _Tip) -> Array:
    """J of the coordinates that the arm has, (k, m), where it starts."""
    own = [c for c in range(len(tip.task.lacks)) if tip.task.has(c)]
    return tip.task.jacobian(tip.arm.q)[own]


def _coupled(system: AnalyzedSystem, tip: _Tip) -> Array:
    """The weights by which neighbours couple each coordinate of the arm, (k,), 1/s."""
    own = [c for c in range(len(tip.task.lacks)) if tip.task.has(c)]
    found = np.zeros(len(own))
    for e in system.edges_to.get(tip.name, ()):
        if e.recurrent:
            heard = np.array([tip.task.hears(e.row, c) for c in own])
            found += tip.law.lambda_ * e.weight * heard
    return found


def passivity(system: AnalyzedSystem) -> Iterator[Finding]:
    """lambda_M <= alpha + lambda_min(G⁻¹ D) at the start: the tip is passive to a fast hand.

    From f on the tip to its velocity: (p + lambda_M)/(p + alpha) J (M p + B)⁻¹ J', B the feedback
    and friction. Its real part for p = jω, times ω², goes to D - (lambda_M - alpha) G, with
    G = J M⁻¹ J' and D = J M⁻¹ B M⁻¹ J'. It must not be negative. Neighbours add (W G + G W)/2,
    with W = diag(lambda Σ w) of what the tip listens to.
    """
    for tip in _tips(system):
        law, q = tip.law, tip.arm.q
        if law.lambda_c or tip.task.regular(q) < 1.0:
            continue
        J = _rows(tip)
        moved = np.linalg.solve(tip.arm.inertia(tip.arm.parameters, q), J.T)
        G, W = J @ moved, np.diag(_coupled(system, tip))
        damping = moved.T @ _gain(tip, q) @ moved + (W @ G + G @ W) / 2
        ratio = np.linalg.eigvals(np.linalg.solve(G, damping))
        limit = law.alpha + float(ratio.real.min())
        if law.lambda_M > limit:
            yield Finding(
                rule="passivity",
                severity="warning",
                where=tip.name,
                number=limit - law.lambda_M,
                unit="1/s",
                reason=f"lambda_M = {law.lambda_M:g} 1/s is above the passive limit {limit:.3g} 1/s"
                " of the tip (exact estimates, at the start): oscillations with a stiff grip or"
                " contact can grow",
                advice=f"lower lambda_M to {limit:.3g}, or raise K_x",
            )


def singular(system: AnalyzedSystem) -> Iterator[Finding]:
    """The theorems need a Jacobian of full rank, which is not damped."""
    for tip in _tips(system):
        found = tip.task.regular(tip.arm.q)
        if found < 1.0:
            yield Finding(
                rule="singular",
                severity="warning",
                where=tip.name,
                number=found,
                unit="1",
                reason=f"the arm starts near a singularity, sigma = {found:.2g} sigma_0: the tip"
                " does not follow there, and nothing proves that the arms agree",
                advice="start in a bent posture, or lower sigma_0",
            )


def missing(system: AnalyzedSystem) -> Iterator[Finding]:
    """Who listens to a coordinate that its neighbour lacks is drawn to 0."""
    tips = {tip.name: tip.task for tip in _tips(system)}
    for e in _between(system, tips):
        here, there = tips[e.receiver], tips[e.sender]
        wrong = [c for c in range(len(here.lacks)) if here.hears(e.row, c) and not there.has(c)]
        if wrong:
            yield Finding(
                rule="lacks",
                severity="warning",
                where=e.receiver,
                number=float(wrong[0]),
                unit="1",
                reason=f"it listens to coordinate {wrong[0]} of {e.sender}, which lacks it and"
                " sends 0: the arm is drawn there",
                advice=f"set listens[{e.row}][{wrong[0]}] = 0",
            )


def spanning_tree(system: AnalyzedSystem) -> Iterator[Finding]:
    """Theorems 3 to 5 in each coordinate: one of the arms that have it must reach all others."""
    tips = {tip.name: tip.task for tip in _tips(system)}
    edges = list(_between(system, tips))
    networked = {name for e in edges for name in (e.receiver, e.sender)}
    for c in range(max((len(tips[name].lacks) for name in networked), default=0)):
        own = sorted(name for name in networked if tips[name].has(c))
        heard = [e for e in edges if tips[e.receiver].hears(e.row, c) and tips[e.sender].has(c)]
        if own and not any(_reached(name, heard) >= set(own) for name in own):
            yield Finding(
                rule="spanning-tree",
                severity="warning",
                where=", ".join(own),
                number=float(c),
                unit="1",
                reason=f"coordinate {c} of no arm reaches all arms that have it: they do not agree"
                " on it (Theorem 3)",
                advice="listen to it, or add links",
            )


def _between(system: AnalyzedSystem, tips: dict[str, TipTask]) -> Iterator[Edge]:
    """The edges between controllers of tips that are there again and again."""
    return (e for e in system.edges if e.recurrent and {e.receiver, e.sender} <= tips.keys())


def _reached(name: str, edges: Sequence[Edge]) -> set[str]:
    found, waiting = {name}, [name]
    while waiting:
        here = waiting.pop()
        new = {e.receiver for e in edges if e.sender == here} - found
        found |= new
        waiting += new
    return found


def free_joints(system: AnalyzedSystem) -> Iterator[Finding]:
    """Joints that the tip leaves free need a posture, or go anywhere."""
    for tip in _tips(system):
        free = len(tip.arm.q) - sum(tip.task.has(c) for c in range(len(tip.task.lacks)))
        if free > 0 and not tip.task.posture:
            yield Finding(
                rule="null-motion",
                severity="note",
                where=tip.name,
                number=float(free),
                unit="1",
                reason=f"the tip leaves {free} of {len(tip.arm.q)} joints free, and no posture is"
                " given: they stay where they are pushed",
                advice="set k_n and q_n",
            )


def stiffness(system: AnalyzedSystem) -> Iterator[Finding]:
    """O5 for tips: (J B⁻¹ J')⁻¹ lambda alpha w_j/lambda_M at the start, B the feedback of s.

    From B s = tau_h = J' f and J s = -z = Σ_j (lambda alpha w_j/lambda_M)(x - x_j) at rest.
    """
    tips = {tip.name: tip for tip in _tips(system)}
    weights: dict[str, list[float]] = {name: [] for name in tips}
    for e in _between(system, {name: tip.task for name, tip in tips.items()}):
        weights[e.receiver].append(e.weight)
    for name, tip in tips.items():
        law, q = tip.law, tip.arm.q
        gain = law.lambda_ * law.alpha * min(weights[name], default=0.0)
        if not gain > 0.0 or not law.lambda_M or law.lambda_c or tip.task.regular(q) < 1.0:
            continue
        J = _rows(tip)
        coupled = np.linalg.inv(J @ np.linalg.solve(tip.task.feedback(q), J.T))
        least, *_, most = np.linalg.eigvalsh(coupled * gain / law.lambda_M)[[0, -1]]
        yield Finding(
            rule="stiffness",
            severity="note",
            where=name,
            number=float(least),
            unit="N/m",
            reason=f"at rest each neighbour holds the tip by a spring of {least:.3g} to {most:.3g}"
            " N/m where it starts (O5): a larger lambda_M is easier to move, and softer",
        )


def sampled_contact(system: AnalyzedSystem) -> Iterator[Finding]:
    """A sampled hand or wall at a tip: k T/2 < b and the damping of the arm there."""
    for wire in system.plan.wires:
        name, arm = wire.source.component, system.arms.get(wire.target.component)
        at = system.facts.get(name)
        if not isinstance(at, TipContact) or arm is None or wire.target.port != arm.external:
            continue
        T = system.period(name)
        J, B = at.jacobian(arm.q), _damping(system, wire.target.component, arm)
        braked = 0.0
        if np.linalg.matrix_rank(J) == len(J) and np.linalg.eigvalsh(B)[0] > 0.0:
            braked = float(np.linalg.eigvalsh(np.linalg.inv(J @ np.linalg.solve(B, J.T)))[0])
        for what, (stiffness, damping) in (("hand", at.hand), ("wall", at.wall)):
            makes, takes = stiffness * T / 2, damping + braked
            if makes > takes:
                yield Finding(
                    rule="hand",
                    severity="warning",
                    where=name,
                    number=makes,
                    unit="N.s/m",
                    reason=f"{what} at the tip, sampled every {T:g} s: k T/2 = {makes:.3g} N.s/m is"
                    f" not below the damping, {takes:.3g}: it makes energy",
                    advice="give it more damping, or sample faster",
                )


def _damping(system: AnalyzedSystem, name: str, arm: Arm) -> Array:
    """The feedback of the arm's controller where it starts, with friction, (m, m) N.m.s/rad."""
    law, B = system.facts.get(system.controls.get(name, "")), np.diag(arm.friction)
    if isinstance(law, DynamicFeedback) and law.task is not None:
        return np.asarray(B + law.task.feedback(arm.q))
    if isinstance(law, DynamicFeedback | SpringDamper):
        return np.asarray(B + np.diag(spread(law.feedback, len(arm.q))))
    return B
