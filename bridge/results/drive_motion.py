"""Check that the joints of an arm move as the torques of their drives ask, by the model of the arm.

The torque that moved joint i in a window is that of the change of its momentum M(q) dq, with what
gravity and friction of the model took. Other forces, and the model's errors, change little from one
window to the next, so differences of neighbouring windows are compared with those of the torques
that were sent: a slope near 1 is right, near 0 nothing follows, below 0 the wrong way.

A hand that moves an arm decides, beside the torques with which the controller answers it, how it
moves: of an arm that is held, only an encoder that stands still tells something.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.cut import NodePlan
from bridge.deployment.system import System
from bridge.wiring.wiring import Rows
from cosim.predict import system as roles
from cosim.predict.facts import Arm

#: A slope below this does not answer, below its negative it goes the wrong way.
SLOPE = 0.25
#: A slope of 1 has to be so many standard errors away from 0, or nothing is said.
CLEAR = 4.0
#: s of a window; the least of them, and the most of an arm that are looked at.
WINDOW, LEAST, MOST = 0.05, 10, 100
#: rad/s: resolution of a velocity that never changes.
COARSE = 0.02
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TorqueAnswer:
    """The slope of an answer on the torque that was sent, and its standard error."""

    slope: float
    error: float

    @classmethod
    def of(cls, sent: Array, answer: Array, step: float) -> TorqueAnswer:
        """The answer in values (n,) of windows, N.m; `step`: its least difference, N.m."""
        power = float(sent @ sent)
        if power <= 0 or len(sent) < LEAST:
            return cls(0.0, np.inf)
        slope = float(sent @ answer) / power
        left = answer - slope * sent
        spread = max(float(left @ left) / (len(sent) - 1), step**2 / 12)
        return cls(slope, float(np.sqrt(spread / power)))

    @property
    def judged(self) -> bool:
        """True if the torques were large enough to tell."""
        return self.error * CLEAR <= 1.0

    @property
    def reversed(self) -> bool:
        """True if it goes the wrong way."""
        return self.judged and self.slope + 3 * self.error < -SLOPE

    @property
    def absent(self) -> bool:
        """True if it is not there, or too small."""
        return self.judged and not self.reversed and self.slope + 3 * self.error < SLOPE

    def __str__(self) -> str:
        """The slope for people."""
        return f"{self.slope:.2f} N.m for each N.m that it was sent"


@dataclass(frozen=True, slots=True)
class JointMotion:
    """The answer of the joint `entry` to the torque of the component `law`.

    `held`: a hand may move the arm; `still`: position and velocity were the same all the time.
    """

    law: str
    entry: int
    answer: TorqueAnswer
    held: bool
    still: bool


def motions(system: System, plan: NodePlan, rows: Rows) -> Iterator[JointMotion]:
    """The joints whose torques a node sends and whose positions and velocities it hears.

    `rows` (n,): its slots. Arms without a model are left out.
    """
    known = roles.system(system.scenario, system.plan)
    for law in sorted({p.component for o in plan.outlets for p in o.parts}):
        name = known.arm_of(law)
        if name is None or name not in known.arms:
            continue
        arm = known.arms[name]
        tau = sent_torques(plan, law, rows)
        q, dq = (heard(system, plan, f"{name}.{p}", rows) for p in (arm.position, arm.rate))
        if tau is None or q is None or dq is None or not tau.shape == q.shape == dq.shape:
            continue
        for entry, answer in enumerate(_answers(arm, tau, q, dq, plan.h)):
            still = bool(np.ptp(q[:, entry]) == 0 and np.ptp(dq[:, entry]) == 0)
            yield JointMotion(law, entry, answer, name in known.held(), still)


def sent_torques(plan: NodePlan, law: str, rows: Rows) -> Array | None:
    """The torques (n, joints) that were sent of a component, N.m; None: not all of them were."""
    whole = plan.plan.slots().get(f"{law}.tau")
    if whole is None:
        return None
    found, first = np.full((len(rows), whole.size), np.nan), 0
    for outlet in plan.outlets:
        for part in outlet.parts:
            if (part.component, part.port) == (law, "tau"):
                at = part.start - whole.start
                found[:, at : at + part.size] = rows["sent"][:, first : first + part.size]
            first += part.size
    return None if np.isnan(found).any() else found


def heard(system: System, plan: NodePlan, port: str, rows: Rows) -> Array | None:
    """A port of another node as this one held it, (n, size), in the port's unit; None: not all of
    it comes here.
    """
    whole = system.plan.slots().get(port)
    if whole is None:
        return None
    found = np.full((len(rows), whole.size), np.nan)
    for inlet in plan.inlets:
        at = inlet.source.start - whole.start
        if 0 <= at < whole.size and inlet.link is None:
            own = inlet.target
            found[:, at : at + own.size] = rows["signals"][:, own.start : own.start + own.size]
    return None if np.isnan(found).any() else found


def _answers(arm: Arm, tau: Array, q: Array, dq: Array, h: float) -> list[TorqueAnswer]:
    """The answer of each joint; signals (n, joints), a row each h (s)."""
    n = max(1, round(WINDOW / h))
    n *= max(1, -(-len(tau) // (n * MOST)))
    edges = np.arange(0, len(tau), n)
    if len(edges) < LEAST:
        return [TorqueAnswer(0.0, np.inf)] * tau.shape[1]
    inertia = np.array([arm.inertia(arm.parameters, q[k]) for k in edges])
    momentum = np.einsum("kij,kj->ki", inertia, dq[edges])
    moved = np.diff(momentum, axis=0) / (n * h)
    middle = (edges[:-1] + edges[1:]) // 2
    moved += np.array(arm.friction) * dq[middle] - _curving(arm, q[middle], dq[middle])
    if arm.weight is not None:
        moved += np.array([arm.weight(arm.gravity, q[k]) for k in middle])
    asked = np.array([tau[a:b].mean(axis=0) for a, b in pairwise(edges)])
    steps = [_step(dq[:, i]) * inertia[:, i, i].max() / (n * h) for i in range(tau.shape[1])]
    return [
        TorqueAnswer.of(np.diff(asked[:, i]), np.diff(moved[:, i]), step)
        for i, step in enumerate(steps)
    ]


def _curving(arm: Arm, q: Array, dq: Array) -> Array:
    """½ dqᵀ ∂M/∂q_i dq (n, joints), N.m: the part of the momentum's change that no torque makes."""
    found, by = np.zeros_like(q), 1e-4
    for i in range(q.shape[1]):
        for k in np.flatnonzero(np.abs(dq).max(axis=1) > COARSE):
            ends = [
                arm.inertia(arm.parameters, q[k] + sign * by * np.eye(q.shape[1])[i])
                for sign in (1, -1)
            ]
            found[k, i] = dq[k] @ (ends[0] - ends[1]) @ dq[k] / (4 * by)
    return found


def _step(dq: Array) -> float:
    """The resolution of a velocity (n,), rad/s."""
    steps = np.abs(np.diff(dq))
    steps = steps[steps > 0]
    return float(steps.min()) if len(steps) else COARSE
