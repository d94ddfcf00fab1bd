"""Closed forms O3 to O6 and O9, with which a run or a response to a test force must agree.

They hold for the robots of :mod:`cosim.predict.network`, linearised about rest; SI, no gravity.

Source: own construction from the paper's equations; docs/paper.md lists the formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, pi

import numpy as np
from numpy.typing import ArrayLike

from cosim.predict.facts import Arm, Array, DynamicFeedback
from cosim.predict.network import Complex, RobotNetwork, spread

#: Where p stands for 0, 1/s: well below any corner, well above rounding.
_ZERO = 1e-6


# ---- O3, O4, O5: slow pole, felt damping, stiffness ---------------------------------------------


def felt_damping(net: RobotNetwork, K: float, friction: float = 0.0) -> float:
    """O4, tau_h over velocity under a constant push, N.m.s/rad; inf where it comes to rest.

    One robot: K alpha/lambda_M + D, where D is the viscous `friction` of the joint. Two:
    K alpha (2 + lambda (T_12 + T_21))/lambda_M + 2 D.
    """
    if not K:  # nothing couples the robots
        return friction
    damping = 1 / (_ZERO * net.quasi_static(_ZERO, K, friction)).real
    return inf if damping > 1e-3 / _ZERO and _is_spring(net, K, friction, damping) else damping


def _is_spring(net: RobotNetwork, K: float, friction: float, damping: float) -> bool:
    """True if what seems a `damping` at :data:`_ZERO` becomes less as the motion becomes faster.

    A spring seems ten times less at ten times the rate, and the sum of many robots the same.
    """
    faster = 1 / (10 * _ZERO * net.quasi_static(10 * _ZERO, K, friction)).real
    return damping > faster * 10**0.5


def felt_when_pushed(net: RobotNetwork, q: Sequence[float], K: Sequence[float]) -> list[float]:
    """The damping that a constant push on all joints feels at each, N.m.s/rad; `K` of each joint.

    Gravity g(q) that a held torque compensates is late by T_s/2, which is a damping g'(q) T_s/2
    that couples the joints; without it each joint is a case of O4. `q` (m,) rad.
    """
    if net.held_weights(q) is None:
        friction = net.arms[net.port].friction
        return [felt_damping(net, k, D) for k, D in zip(K, friction, strict=True)]
    gain = net.at(q, net.true_estimates()).gain(np.array([_ZERO]))[0].real
    return [float(1 / v) for v in _ZERO * gain.sum(axis=1)]


def felt_stiffness(net: RobotNetwork, K: float, friction: float = 0.0) -> float:
    """Torque over displacement under a constant push, N.m/rad; 0 where it moves for ever.

    alpha K for one robot with lambda_M = 0 (O2: M^t -> 1/(alpha K)).
    """
    stiffness = 1 / net.quasi_static(_ZERO, K, friction).real
    is_spring = stiffness > 1e3 * _ZERO and _is_spring(net, K, friction, stiffness / _ZERO)
    return stiffness if is_spring else 0.0


def static_stiffness(law: DynamicFeedback, weight: float, K: float) -> float:
    """O5, kappa = lambda w alpha K/lambda_M: at rest tau_1* = kappa (q_1 - q_2), N.m/rad."""
    if not law.lambda_M:
        return inf
    return law.lambda_ * weight * law.alpha * K / law.lambda_M


def quasi_static_poles(law: DynamicFeedback, K: float, k_p: float, k_d: float) -> Complex:
    """Return the poles (2,) of one robot in a hand without inertia (O3), slowest first, 1/s.

    (1 + k_d/K) p² + (alpha + (lambda_M k_d + k_p)/K) p + lambda_M k_p/K = 0
    """
    rate = law.alpha + (law.lambda_M * k_d + k_p) / K
    return _sorted(np.roots([1 + k_d / K, rate, law.lambda_M * k_p / K]))


#: Coordinates up to which the determinant of a whole network is well scaled, and up to which poles
#: are looked for at all.
WHOLE, MANY = 24, 600


def poles(
    net: RobotNetwork,
    q: Sequence[float],
    estimates: Sequence[Sequence[float]],
    k_p: Sequence[float],
    k_d: Sequence[float],
) -> Complex:
    """Return the poles (n,) of the network with a hand at its port, slowest first, 1/s.

    Roots of det(A(p) + k_p + k_d p) = 0, with k_p and k_d at the port and with inertia; of more
    than WHOLE coordinates only those that the hand can feel, of what the port sees of the network.
    With delays there are infinitely many; the result contains those that Newton's method finds from
    a fan of starts, the slowest of them below k_p over the felt damping. Of more than MANY
    coordinates there are none, since each step would take seconds.
    """
    m, n = len(q), len(net.laws)
    if n * m > MANY:
        return np.zeros(0, dtype=np.complex128)
    linear = net.at(q, estimates)
    port = np.arange(net.port * m, (net.port + 1) * m)
    others = np.concatenate([np.arange(port[0]), np.arange(port[-1] + 1, n * m)])
    grip, damping = np.diag(spread(k_p, m)), np.diag(spread(k_d, m))

    def seen(p: Complex) -> Complex:
        """A(p) at the port, with everything else at rest, (k, m, m)."""
        A = linear.A(p)
        there = A[:, port[:, None], port]
        if not len(others):
            return np.asarray(there)
        rest = np.linalg.solve(A[:, others[:, None], others], A[:, others[:, None], port])
        return np.asarray(there - A[:, port[:, None], others] @ rest)

    def whole(p: Complex) -> Complex:
        A = linear.A(p)
        A[:, port[:, None], port] += grip + p[:, None, None] * damping
        return np.asarray(np.linalg.det(A) * (p + net.law.lambda_M) ** (n * m))

    def felt(p: Complex) -> Complex:
        A = seen(p) + grip + p[:, None, None] * damping
        return np.asarray(np.linalg.det(A) * (p + net.law.lambda_M) ** m)

    scale = max(*(law.lambda_M for law in net.laws), *(law.alpha for law in net.laws), 1.0)
    slow = 1e-4 * scale
    drag = np.abs(np.diagonal(seen(np.array([1j * slow]))[0])).max() / slow
    lowest = min(0.02, 0.5 * max(spread(k_p, m)) / (drag + max(spread(k_d, m))) / scale)
    turns = np.exp(1j * np.array([pi, 0.85 * pi, 0.65 * pi]))
    starts = np.geomspace(max(lowest, 1e-5), 2.0, 9)
    if n * m > WHOLE:  # the slowest ones only
        starts, turns = starts[:3], turns[:1]
    fan = np.asarray(scale * starts[:, None] * turns, dtype=np.complex128)
    found: list[complex] = []
    for p in _newton(whole if n * m <= WHOLE else felt, fan.ravel()):
        away = abs(p + net.law.lambda_M) > 1e-3
        if away and all(abs(p - other) > 1e-5 * scale for other in found):
            found.append(complex(p))
    return _sorted(np.array(found))


def _sorted(roots: ArrayLike) -> Complex:
    found = np.asarray(roots, dtype=np.complex128)
    return found[np.lexsort((found.imag, -found.real))]


def _newton(f: Callable[[Complex], Complex], p: Complex) -> Complex:
    """The roots that Newton's method reaches from each of `p` (k,), where it converges."""
    change = np.full_like(p, np.inf)
    with np.errstate(all="ignore"):
        for _ in range(50):
            step = 1e-6 * (1 + np.abs(p))
            change = f(p) * 2 * step / (f(p + step) - f(p - step))
            p = np.where(np.isfinite(change), p - change, p)
            if (np.abs(change) < 1e-9 * (1 + np.abs(p))).all():
                break
    return np.asarray(p[np.abs(change) < 1e-9 * (1 + np.abs(p))])


# ---- O6, O9: gains ------------------------------------------------------------------------------


def manipulability_bound(net: RobotNetwork, t: Array, K: float) -> Array:
    """O6, M^t <= (1 + 2 lambda_M t/π) ‖H‖/(alpha lambda_min(K)), rad/(N.m), theta known.

    1/lambda_min(K) bounds tau_h -> s, 1/alpha is a filter, 2 t/π the norm of the integral over
    [0, t], and H(p) = p mean_i [L⁻¹]_i,port the effect of the network on the mean position of its
    robots (1 for one robot). inf for alpha = 0. `t` (n,) s; `K`: the least feedback gain,
    N.m.s/rad; the result (n,).
    """
    law = net.law
    if law.alpha == 0:
        return np.full_like(t, inf)
    p = 1j * np.geomspace(1e-4, 1e3, 400)
    H = np.abs(p * net.mean_inverse(p)).max()
    return np.asarray((1 + 2 * law.lambda_M * t / pi) * H / (law.alpha * K))


def passive_limit(law: DynamicFeedback, M: Array, K: Sequence[float]) -> float:
    """O9, the lambda_M up to which a robot alone is passive to its operator, theta known, 1/s.

    Of coupled robots see :func:`cosim.predict.passivity.passive_range`.
    alpha + lambda_min(K M⁻¹); with Remark 3 alpha + lambda_c, whatever the inertia. `M` (m, m)
    kg.m2; `K` N.m.s/rad, one value or m, with the viscous friction of the joints.
    """
    if law.lambda_c:
        return law.alpha + law.lambda_c
    diagonal = np.diag(spread(K, len(M)))
    return float(law.alpha + np.linalg.eigvals(diagonal @ np.linalg.inv(M)).real.min())


def damped(K: Sequence[float], arm: Arm) -> tuple[float, ...]:
    """The feedback gain of each joint with its viscous friction, N.m.s/rad."""
    friction = arm.friction
    return tuple((spread(K, len(friction)) + friction).tolist())


def stiffest_network_grip(
    net: RobotNetwork,
    q: Sequence[float],
    k_p: Sequence[float] = (1.0,),
    k_d: Sequence[float] = (0.0,),
    count: int = 800,
) -> float:
    """The multiple of a grip at the port at which it begins to swing, theta known.

    `k_p` (N.m/rad) and `k_d` (N.m.s/rad) of the grip: one for all joints, or one each. At x times
    this grip det(1 + x (k_p + k_d jω) G(jω)) = 0: an eigenvalue of (k_p + k_d jω) G crosses the
    negative real axis at -1/x. The least x over `count` frequencies; inf where there is none. With
    k_p = 1 and no damping it is a stiffness.
    """
    p = 1j * np.geomspace(0.05, 500.0, count)
    grip = spread(k_p, len(q)) + p[:, None] * spread(k_d, len(q))
    G = grip[:, :, None] * net.at(q, net.true_estimates()).gain(p)
    eigenvalues = np.linalg.eigvals(G)
    least, before = inf, eigenvalues[0]
    for here in eigenvalues[1:]:
        here = here[[int(np.argmin(np.abs(here - x))) for x in before]]  # branch by branch
        for x, y in zip(before, here, strict=True):
            if x.imag * y.imag < 0 and x.real < 0 and y.real < 0:
                crossing = x.real + (y.real - x.real) * x.imag / (x.imag - y.imag)
                least = min(least, -1 / crossing)
        before = here
    return float(least)
