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

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.predict.ages import Age
from cosim.predict.facts import Arm, Array, DynamicFeedback, Vector
from cosim.predict.system import AnalyzedSystem

Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

#: Step of the derivative of gravity, rad.
STEP = 1e-4
#: Robots beyond which the matrix of their couplings is taken as almost empty.
DENSE = 30


class Couplings(Struct, frozen=True):
    """The edges of a network, from robot `senders[k]` to robot `receivers[k]`, (edges,).

    `strength`: lambda w, 1/s; `kinds`: which of the `ages` what the receiver holds has.
    """

    receivers: Indices
    senders: Indices
    strength: Array
    kinds: Indices
    ages: tuple[Age, ...]

    def around(self, n: int) -> Array:
        """The sum of the strengths of the edges to each of `n` robots, (n,), 1/s."""
        return np.bincount(self.receivers, self.strength, n).astype(np.float64)

    def heard(self, p: Complex) -> Complex:
        """The strength of each edge with its delay, (..., edges), 1/s, for each p (...)."""
        late = np.empty((*p.shape, len(self.ages)), dtype=np.complex128)
        for kind, age in enumerate(self.ages):
            late[..., kind] = np.exp(-p * age.mean)
            if age.spread:
                late[..., kind] *= np.exp(-p[..., None] * np.asarray(age.spread)).mean(axis=-1)
        return np.asarray(self.strength * late[..., self.kinds])


class RobotNetwork(Struct, frozen=True):
    """The robots that communicate; the `port` is at the one that the operator holds.

    `outside` (n,): lambda w of rows from unknown senders, which count as standing still, 1/s;
    `periods`: of the laws, s.
    """

    names: tuple[str, ...]
    arms: tuple[Arm, ...]
    laws: tuple[DynamicFeedback, ...]
    couplings: Couplings
    outside: Array
    port: int
    periods: Vector = ()

    @property
    def law(self) -> DynamicFeedback:
        """The law at the port."""
        return self.laws[self.port]

    @property
    def around(self) -> Array:
        """The sum of the weights that couple each robot to the others, (n,), 1/s."""
        return self.couplings.around(len(self.laws)) + self.outside

    def L(self, p: ArrayLike) -> Complex:
        """The matrix of the delayed couplings, (..., n, n), 1/s, for one p or several, (...)."""
        p, edges = np.asarray(p, dtype=np.complex128), self.couplings
        one = np.eye(len(self.laws))
        heard = np.zeros((*p.shape, *one.shape), dtype=np.complex128)
        np.add.at(heard, (..., edges.receivers, edges.senders), edges.heard(p))  # type: ignore[arg-type]
        return np.asarray(p[..., None, None] * one + np.diag(self.around) - heard)

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
        law, n = self.law, len(self.laws)
        feedback = K * (p + law.alpha) / (p + law.lambda_M)
        if n > DENSE:
            return complex(self._column(p, feedback, friction * p)[self.port])
        A = feedback * self.L(p) + friction * p * np.eye(n)
        return complex(np.linalg.inv(A)[self.port, self.port])

    def mean_inverse(self, p: ArrayLike) -> Complex:
        """The mean over the robots i of [L(p)⁻¹]_i,port, (k,) s, for p (k,)."""
        if len(self.laws) > DENSE:
            return np.array([self._column(x).mean() for x in np.asarray(p).tolist()])
        return np.asarray(np.linalg.inv(self.L(p))[:, :, self.port].mean(axis=1))

    def _column(self, p: complex, feedback: complex = 1.0, own: complex = 0.0) -> Complex:
        """The column at the port of (`feedback` L(p) + `own`)⁻¹, (n,)."""
        from cosim.predict.elimination import column

        edges = self.couplings
        diagonal = feedback * (p + self.around) + own
        heard = -feedback * edges.heard(np.asarray(p, dtype=np.complex128))
        one, other = (np.asarray(x)[:, None, None] for x in (diagonal, heard))
        return np.asarray(column(one, other, edges.receivers, edges.senders, self.port)[:, 0, 0])


class Linear(Struct, frozen=True):
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
        """The transfer function from positions to torques, (..., n m, n m), N.m/rad, for one p or
        several, (...).
        """
        p = np.asarray(p, dtype=np.complex128)
        n, m = self.M.shape[:2]
        blocks = np.einsum("...iab,...ij->...iajb", self._feedback(p), self.net.L(p))
        each = np.arange(n)
        for part in self._alone(p):
            blocks[..., each, :, each, :] += np.moveaxis(part, -3, 0)
        return np.asarray(blocks.reshape(*p.shape, n * m, n * m))

    def _feedback(self, p: Complex) -> Complex:
        """The factor of L(p) of each robot, (..., n, m, m), N.m.s/rad."""
        alpha = np.array([law.alpha for law in self.net.laws])[:, None, None]
        lambda_M = np.array([law.lambda_M for law in self.net.laws])[:, None, None]
        s = p[..., None, None, None]
        return np.asarray((self.M_hat * s + self.K) * (s + alpha) / (s + lambda_M))

    def _alone(self, p: Complex) -> Iterator[Complex]:
        """The part of each robot that the couplings do not change, (..., n, m, m), N.m/rad."""
        s = p[..., None, None, None]
        friction = self.friction[:, :, None] * np.eye(self.M.shape[1])
        yield np.asarray((self.M - self.M_hat) * s * s + friction * s)
        if self.weight is not None:
            T = np.asarray(self.net.periods)[:, None, None]
            yield np.asarray(self.weight * (1 + np.expm1(-s * T) / (s * T)))

    def gain(self, p: ArrayLike) -> Complex:
        """G(p), (..., m, m), rad/(N.m): from torque to position at the port."""
        return np.asarray(self._column(p)[..., self.net.port, :, :])

    def mean_gain(self, p: ArrayLike) -> Complex:
        """The transfer function from torque at the port to the mean position of all robots, (...,
        m, m), rad/(N.m).
        """
        return np.asarray(self._column(p).mean(axis=-3))

    def _column(self, p: ArrayLike) -> Complex:
        """The transfer functions from torque at the port to all positions, (..., n, m, m),
        rad/(N.m).
        """
        p = np.asarray(p, dtype=np.complex128)
        n, m = self.M.shape[:2]
        if n > DENSE:
            each = [self._sparse_column(x) for x in p.ravel()]
            return np.array(each).reshape(*p.shape, n, m, m)
        at = slice(self.net.port * m, (self.net.port + 1) * m)
        found = np.linalg.inv(self.A(p))[..., at]
        return np.asarray(found.reshape(*p.shape, n, m, m))

    def _sparse_column(self, p: Complex) -> Complex:
        """The same for one p, by elimination."""
        from cosim.predict.elimination import column

        edges, feedback = self.net.couplings, self._feedback(p)
        own = feedback * (p + self.net.around)[:, None, None] + sum(self._alone(p))
        heard = -feedback[edges.receivers] * edges.heard(p)[:, None, None]
        return column(own, heard, edges.receivers, edges.senders, self.net.port)


def network(system: AnalyzedSystem, port: str) -> RobotNetwork | None:
    """The network that the arm `port` is part of; None where its law is not of this kind.

    A law in the coordinates of a tip is not: the arms' joints are not coupled one by one.
    """
    return system.once("network", port, lambda: _network(system, port))


def _network(system: AnalyzedSystem, port: str) -> RobotNetwork | None:
    start = system.controls.get(port, "")
    if start not in system.with_facts(DynamicFeedback):
        return None
    groups = system.once("groups", "", lambda: _groups(system))
    names = groups.get(start, (start,))
    found = system.once("group", names[0], lambda: _connected(system, names))
    return None if found is None else replace(found, port=names.index(start))


def _groups(system: AnalyzedSystem) -> Mapping[str, tuple[str, ...]]:
    """The laws that communicate with each other, sorted, by each of their names."""
    beside: dict[str, set[str]] = {}
    for e in system.edges:
        if e.recurrent and e.sender:
            beside.setdefault(e.receiver, set()).add(e.sender)
            beside.setdefault(e.sender, set()).add(e.receiver)
    groups: dict[str, tuple[str, ...]] = {}
    for start in beside:
        if start in groups:
            continue
        known, waiting = {start}, [start]
        while waiting:
            new = beside[waiting.pop()] - known
            known |= new
            waiting += new
        groups |= dict.fromkeys(known, tuple(sorted(known)))
    return groups


def _connected(system: AnalyzedSystem, names: tuple[str, ...]) -> RobotNetwork | None:
    """The network of the laws `names`, with its port at the first of them."""
    laws = system.with_facts(DynamicFeedback)
    if any(system.arm_of(name) is None or laws[name].task is not None for name in names):
        return None
    chosen = tuple(laws[name] for name in names)
    if any(law.beyond or not law.K for law in chosen):
        return None
    numbers = {name: i for i, name in enumerate(names)}
    outside = np.zeros(len(names))
    ages: dict[Age, int] = {}
    edges: list[tuple[int, int, float, int]] = []
    heard = (e for name in names for e in system.edges_to.get(name, ()) if e.recurrent)
    for e in heard:
        i, strength = numbers[e.receiver], laws[e.receiver].lambda_ * e.weight
        if e.sender in numbers:
            age = system.age(e.link) if e.link is not None else Age()
            edges.append((i, numbers[e.sender], strength, ages.setdefault(age, len(ages))))
        else:
            outside[i] += strength
    receivers, senders, strengths, kinds = zip(*edges, strict=True) if edges else ((),) * 4
    couplings = Couplings(
        np.array(receivers, dtype=np.intp), np.array(senders, dtype=np.intp),
        np.array(strengths), np.array(kinds, dtype=np.intp), tuple(ages),
    )  # fmt: skip
    arms = tuple(system.arms[str(system.arm_of(name))] for name in names)
    periods = tuple(system.period(name) for name in names)
    return RobotNetwork(names, arms, chosen, couplings, outside, 0, periods)


def spread(values: Sequence[float], m: int) -> Array:
    """One value a joint, (m,), of one for all or one each."""
    return np.broadcast_to(np.asarray(values, dtype=np.float64), (m,))
