"""Coupled robots under dynamic feedback, linearised about rest.

With the estimate at rest, M_hat = M(theta_hat), and delays T_ij, robots i in one posture each
obey, in the Laplace variable p (matrices over joints, blocks over robots)::

    A(p) q = tau_h,   A = (M - M_hat) p² + D p + (M_hat p + K) (p + alpha)/(p + lambda_M) L(p)

    L(p) = p + lambda Σ_j w_ij  on the diagonal,   - lambda w_ij exp(-p T_ij)  off it

If a delay jumps, exp(-p T_ij) is the mean over the distribution of T_ij. This is the average
behaviour of the robots if a delay is redrawn faster than they move. The equations follow from s =
(p + alpha)/(p + lambda_M) L q and M p² q = -D p q - K s + M_hat p (p q - s) + tau_h, where D is the
viscous friction of the arm. Gravity that is compensated by a torque held for a period T_s is late
by half of it, so that A has g'(q) (1 - (1 - exp(-p T_s))/(p T_s)) more. A single robot without
friction has L = p; for M_hat = M its admittance is dq/tau_h = (p + lambda_M)/((M p + K)(p +
alpha)). SI; Remark 3 is K = lambda_c M_hat.

Source: own construction, the linearisation of the paper's (42)-(45), (61) and (76)-(81).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.analysis.facts import Arm, Array, DynamicFeedback, Vector
from cosim.analysis.system import AnalyzedSystem

Complex = NDArray[np.complex128]

#: Step of the derivative of gravity, rad.
STEP = 1e-4


@dataclass(frozen=True, slots=True)
class RobotNetwork:
    """The robots that communicate; the `port` is at the one that the operator holds.

    `coupling` (n, n): lambda w_ij, 1/s; `delay` (n, n): mean T_ij, s; `jitter`: differences from
    that mean, s, equally likely, of the edges (i, j) whose delay varies; `outside` (n,): lambda w
    of rows from unknown senders, which count as standing still; `periods`: of the laws, s.
    """

    names: tuple[str, ...]
    arms: tuple[Arm, ...]
    laws: tuple[DynamicFeedback, ...]
    coupling: Array
    delay: Array
    outside: Array
    port: int
    jitter: Mapping[tuple[int, int], Vector] = field(default_factory=dict)
    periods: Vector = ()

    @property
    def law(self) -> DynamicFeedback:
        """The law at the port."""
        return self.laws[self.port]

    def L(self, p: ArrayLike) -> Complex:
        """The matrix of the delayed couplings, (..., n, n), 1/s, for one p or several, (...)."""
        p = np.asarray(p, dtype=np.complex128)[..., None, None]
        around = self.coupling.sum(axis=1) + self.outside
        own = p * np.eye(len(around)) + np.diag(around)
        heard = self.coupling * np.exp(-p * self.delay)
        for (i, j), spread_ in self.jitter.items():
            heard[..., i, j] *= np.exp(-p[..., 0] * np.asarray(spread_)).mean(axis=-1)
        return np.asarray(own - heard)

    def at(self, q: Sequence[float], estimates: Sequence[Sequence[float]]) -> Linear:
        """All robots at `q` (m,), with the `estimates` theta_hat of each."""
        m = len(q)
        M = np.array([arm.inertia(arm.parameters, q) for arm in self.arms])
        M_hat = np.array([
            arm.inertia(e, q) if law.feeds_forward and e else np.zeros((m, m))
            for law, arm, e in zip(self.laws, self.arms, estimates, strict=True)
        ])  # fmt: skip
        K = [
            law.lambda_c * M_hat[i] if law.lambda_c else np.diag(spread(law.K, m))
            for i, law in enumerate(self.laws)
        ]
        friction = np.array([arm.friction for arm in self.arms])
        return Linear(self, M, M_hat, np.array(K), friction, self.held_weights(q))

    def held_weights(self, q: Sequence[float]) -> Array | None:
        """dg/dq of the robots whose gravity is compensated, (n, m, m) N.m/rad; None without any."""
        m = len(q)
        found = np.zeros((len(self.laws), m, m))
        for i, (law, arm) in enumerate(zip(self.laws, self.arms, strict=True)):
            if self.periods and law.gravity == "compensated" and arm.weight is not None:
                for k, side in enumerate(STEP * np.eye(m)):
                    ends = [arm.weight(arm.gravity, np.add(q, x).tolist()) for x in (side, -side)]
                    found[i, :, k] = (ends[0] - ends[1]) / (2 * STEP)
        return found if found.any() else None

    def true_estimates(self) -> tuple[tuple[float, ...], ...]:
        """The estimates that are right: M_hat = M."""
        return tuple(arm.parameters for arm in self.arms)

    def initial_estimates(self) -> tuple[tuple[float, ...], ...]:
        """The estimates at the start."""
        return tuple(law.theta_hat for law in self.laws)

    def quasi_static(self, p: complex, K: float, friction: float = 0.0) -> complex:
        """G(p) of a joint without inertia, rad/(N.m).

        `K`: the feedback gain of that joint, and `friction` its viscous friction, N.m.s/rad, the
        same for all robots.
        """
        law = self.law
        A = K * (p + law.alpha) / (p + law.lambda_M) * self.L(p)
        A += friction * p * np.eye(len(self.laws))
        return complex(np.linalg.inv(A)[self.port, self.port])


@dataclass(frozen=True, slots=True)
class Linear:
    """The robots of `net` in one posture: `M`, `M_hat`, kg.m2, `K`, N.m.s/rad, (n, m, m) each.

    `friction`: the viscous friction of the joints, (n, m) N.m.s/rad; `weight`: dg/dq of gravity
    that is compensated, (n, m, m) N.m/rad.
    """

    net: RobotNetwork
    M: Array
    M_hat: Array
    K: Array
    friction: Array
    weight: Array | None = None

    def A(self, p: ArrayLike) -> Complex:
        """From positions to torques, (..., n m, n m), N.m/rad, for one p or several, (...)."""
        p = np.asarray(p, dtype=np.complex128)
        n, m = self.M.shape[:2]
        alpha = np.array([law.alpha for law in self.net.laws])[:, None, None]
        lambda_M = np.array([law.lambda_M for law in self.net.laws])[:, None, None]
        s = p[..., None, None, None]
        feedback = (self.M_hat * s + self.K) * (s + alpha) / (s + lambda_M)  # (..., n, m, m)
        blocks = np.einsum("...iab,...ij->...iajb", feedback, self.net.L(p))
        own = np.arange(n)
        friction = self.friction[:, :, None] * np.eye(m)
        blocks[..., own, :, own, :] += np.moveaxis(
            (self.M - self.M_hat) * s * s + friction * s, -3, 0
        )
        if self.weight is not None:
            T = np.asarray(self.net.periods)[:, None, None]
            blocks[..., own, :, own, :] += np.moveaxis(
                self.weight * (1 + np.expm1(-s * T) / (s * T)), -3, 0
            )
        return np.asarray(blocks.reshape(*p.shape, n * m, n * m))

    def gain(self, p: ArrayLike) -> Complex:
        """G(p), (..., m, m), rad/(N.m): from torque to position at the port."""
        m = self.M.shape[1]
        at = slice(self.net.port * m, (self.net.port + 1) * m)
        return np.asarray(np.linalg.inv(self.A(p))[..., at, at])

    def mean_gain(self, p: ArrayLike) -> Complex:
        """From torque at the port to the mean position of all robots, (..., m, m), rad/(N.m)."""
        n, m = self.M.shape[:2]
        at = slice(self.net.port * m, (self.net.port + 1) * m)
        column = np.linalg.inv(self.A(p))[..., at]
        return np.asarray(column.reshape(*column.shape[:-2], n, m, m).mean(axis=-3))


def network(system: AnalyzedSystem, port: str) -> RobotNetwork | None:
    """The network that the arm `port` is part of; None where its law is not of this kind.

    A law in the coordinates of a tip is not: the arms' joints are not coupled one by one.
    """
    return system.once("network", port, lambda: _network(system, port))


def _network(system: AnalyzedSystem, port: str) -> RobotNetwork | None:
    laws = system.with_facts(DynamicFeedback)
    start = system.controls.get(port, "")
    if start not in laws:
        return None
    beside: dict[str, set[str]] = {}
    for e in system.edges:
        if e.recurrent and e.sender:
            beside.setdefault(e.receiver, set()).add(e.sender)
            beside.setdefault(e.sender, set()).add(e.receiver)
    known, waiting = {start}, [start]
    while waiting:
        new = beside.get(waiting.pop(), set()) - known
        known |= new
        waiting += new
    names = sorted(known)
    numbers = {name: i for i, name in enumerate(names)}
    if any(system.arm_of(name) is None or laws[name].task is not None for name in names):
        return None
    n = len(names)
    coupling, delay, outside = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    jitter: dict[tuple[int, int], Vector] = {}
    for e in (e for e in system.edges if e.receiver in numbers and e.recurrent):
        i, strength = numbers[e.receiver], laws[e.receiver].lambda_ * e.weight
        if e.sender in numbers:
            j = numbers[e.sender]
            coupling[i, j] += strength
            delay[i, j] = e.age.mean
            if e.age.spread:
                jitter[i, j] = e.age.spread
        else:
            outside[i] += strength
    arms = tuple(system.arms[str(system.arm_of(name))] for name in names)
    chosen = tuple(laws[name] for name in names)
    if any(law.beyond or not law.K for law in chosen):
        return None
    at = names.index(start)
    periods = tuple(system.period(name) for name in names)
    return RobotNetwork(tuple(names), arms, chosen, coupling, delay, outside, at, jitter, periods)


def spread(values: Sequence[float], m: int) -> Array:
    """One value a joint, (m,), of one for all or one each."""
    return np.broadcast_to(np.asarray(values, dtype=np.float64), (m,))
