"""Closed forms a run must agree with; no figure of the paper is needed for them.

All for the horizontal arm (no gravity), K = K I a scalar, PD operator (k_p, k_d, q_h), coupling
lambda with weights 1. SI throughout; positions and torques may be arrays, one entry a joint.
p is the Laplace variable. Derivations: at rest, or in steady drift, every derivative in the
closed loop is constant and the integral of s grows linearly, so that only algebra remains.

Source: own construction from the paper's equations; docs/paper.md lists the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


# ---- O2, O7: the rest position without lambda_M -------------------------------------------------


def rest_position(
    q_0: ArrayLike, q_h: ArrayLike, K: float, alpha: float, k_p: float, z_0: ArrayLike = 0.0
) -> Array:
    """O2, where the arm comes to rest for lambda_M = 0, rad; `q_0`, `q_h` and the result (m,).

    q = (αK ψ_0 + k_p q_h) / (αK + k_p), ψ_0 = q(0) + z(0)/α; from z + αq = αψ_0 for all t, and
    τ_h = K s at rest. `z_0`: z(0), rad/s, scalar or (m,).
    """
    a = alpha * K
    psi_0 = np.asarray(q_0) + np.asarray(z_0) / alpha
    return np.asarray((a * psi_0 + k_p * np.asarray(q_h)) / (a + k_p))


def holding_torque(q_0: ArrayLike, q_h: ArrayLike, K: float, alpha: float, k_p: float) -> Array:
    """O2, torque that holds the arm there: τ_h = k_p (q_h - q), N.m; scalar or (m,)."""
    return k_p * (np.asarray(q_h) - rest_position(q_0, q_h, K, alpha, k_p))


def finite_manipulability(K: float, alpha: float) -> float:
    """O2, limit of M^t for lambda_M = 0: 1/(αK), rad/(N.m)."""
    return 1.0 / (alpha * K)


def rest_position_pair(
    starts: ArrayLike,
    q_h: ArrayLike,
    K: float,
    alpha: float,
    k_p: float,
    lambda_: float,
    delays: tuple[float, float],
) -> Array:
    """O2 of the teleoperator: where both arms rest for lambda_M = 0 and constant delays, rad.

    q = (α (1 + λT_21) q_1(0) + α (1 + λT_12) q_2(0) + (k_p/K) q_h)/(α (2 + λ(T_12 + T_21)) + k_p/K)

    from ξ_1 + ξ_2 + λ∫ξ_2 + λ∫ξ_1 - s_1 - s_2, the integrals over what is on its way, which does
    not change; `starts` (2, m), `delays` = (T_12, T_21) s, as in eqs (80), (81).
    """
    q_1, q_2 = np.asarray(starts, dtype=np.float64)
    w_1, w_2 = alpha * (1 + lambda_ * delays[1]), alpha * (1 + lambda_ * delays[0])
    pull = k_p / K
    return np.asarray((w_1 * q_1 + w_2 * q_2 + pull * np.asarray(q_h)) / (w_1 + w_2 + pull))


# ---- O3: how fast the operator's position is reached --------------------------------------------


def poles(
    K: float, alpha: float, lambda_M: float, k_p: float, k_d: float, mass: float = 0.0
) -> Array:
    """O3, poles of one arm in the operator's hand, (2,) or (3,), slow one first, 1/s (real parts).

    m p³ + (K + αm + k_d) p² + (αK + λ_M k_d + k_p) p + λ_M k_p = 0, from the admittance
    dq/τ_h = (p + λ_M)/((m p + K)(p + α)) of a joint with `mass` m (kg.m2) and theta known.
    m = 0 is the quasi-static form, K s = τ_h, divided by K: (1 + k_d/K) p² + ... .
    """
    polynomial = [
        mass,
        K + alpha * mass + k_d,
        alpha * K + lambda_M * k_d + k_p,
        lambda_M * k_p,
    ]
    return np.sort(np.roots(np.trim_zeros(polynomial, "f")).real)[::-1]


def delayed_pole(
    K: float,
    alpha: float,
    lambda_M: float,
    k_p: float,
    k_d: float,
    lambda_: float,
    delays: tuple[float, float],
) -> float:
    """O3 of the teleoperator, quasi-static, whose delays are redrawn fast: slowest pole, 1/s.

    (p + λ)² - λ² E² + (p + λ) (p + λ_M)(k_d p + k_p)/(K (p + α)) = 0, where E is the mean of
    exp(-pT) over T ~ U[`delays`] (s): what arrives is the mean over the draws. The largest real
    root, which must lie between -α and 0.
    """
    low, high = delays

    def characteristic(p: float) -> float:
        mean = (exp(-p * low) - exp(-p * high)) / (p * (high - low))
        hand = (p + lambda_M) * (k_d * p + k_p) / (K * (p + alpha))
        return (p + lambda_) ** 2 - (lambda_ * mean) ** 2 + (p + lambda_) * hand

    grid = -np.geomspace(1e-6, 0.999 * min(alpha, lambda_), 4000)
    signs = np.sign([characteristic(float(p)) for p in grid])
    k = int(np.argmax(signs != signs[0]))
    stable, slow = float(grid[k]), float(grid[k - 1])
    for _ in range(60):
        middle = (stable + slow) / 2
        stable, slow = (
            (stable, middle)
            if characteristic(middle) * characteristic(slow) > 0
            else (middle, slow)
        )
    return slow


# ---- O4, O5: a constant push, and a wall --------------------------------------------------------


def felt_damping(
    K: float, alpha: float, lambda_M: float, lambda_: float = 0.0, round_trip: float = 0.0
) -> float:
    """O4, τ_h / velocity under a constant push, N.m.s/rad.

    One arm: Kα/λ_M. Teleoperator: Kα (2 + λ (T_12 + T_21))/λ_M, with `lambda_` = λ and the mean
    `round_trip` = T_12 + T_21 (s): two arms to drag, and what the delay stretches between them.
    """
    arms = 2.0 + lambda_ * round_trip if lambda_ else 1.0
    return K * alpha * arms / lambda_M


def static_stiffness(K: float, alpha: float, lambda_M: float, lambda_: float) -> float:
    """O5, κ = λαK/λ_M: at rest τ_1* = τ_2* = κ (q_1 - q_2), N.m/rad."""
    return lambda_ * alpha * K / lambda_M


def sync_offset(tau: float, K: float, alpha: float, lambda_M: float, lambda_: float) -> float:
    """O5, q_1 - q_2 in steady drift under a constant push tau: λ_M τ/(2λαK), rad, at any delay."""
    return tau / (2.0 * static_stiffness(K, alpha, lambda_M, lambda_))


def wall_torque(q_h: ArrayLike, q_w: ArrayLike, k_p: float, kappa: float, k_w: float) -> Array:
    """O5, torque through grip, teleoperator and wall at rest, three springs in series, N.m.

    k_p (q_h - q_1) = κ (q_1 - q_2) = k_w (q_2 - q_w); `q_h`, `q_w` and the result scalar or (m,).
    """
    return np.asarray((np.asarray(q_h) - np.asarray(q_w)) / (1 / k_p + 1 / kappa + 1 / k_w))


# ---- O6, O8: gains ------------------------------------------------------------------------------


def manipulability_bound(t: ArrayLike, K: float, alpha: float, lambda_M: float) -> Array:
    """O6, M^t <= (1 + 2 λ_M t/π)/(α λ_min(K)), rad/(N.m), theta known; `t` in s, scalar or (n,).

    1/λ_min(K) bounds τ_h -> s, 1/α is the filter p -> q, and 2t/π the gain of the integral over
    [0, t] (norm of the Volterra operator).
    """
    return np.asarray((1.0 + 2.0 * lambda_M * np.asarray(t) / pi) / (alpha * K))


def inertia(theta: Sequence[float], q: Array) -> Array:
    """M(q), kg.m2, (n, 2, 2), of the planar arm; `theta` (3,) kg.m2, `q` (n, 2) rad."""
    c2 = np.cos(q[:, 1])
    m11, m12 = theta[0] + 2 * theta[1] * c2, theta[2] + theta[1] * c2
    m22 = np.full_like(c2, theta[2])
    return np.stack([m11, m12, m12, m22], axis=1).reshape(-1, 2, 2)


def lyapunov(theta: Sequence[float], q: Array, s: Array, theta_hat: Array, Gamma: float) -> Array:
    """O8, V = sᵀM(q)s/2 + (θ̂ - θ)ᵀΓ⁻¹(θ̂ - θ)/2, eq. (34), J, (n,); does not grow if τ_h = 0.

    `q`, `s` (n, 2), `theta_hat` (n, 3), `theta` (3,).
    """
    error = theta_hat - np.asarray(theta)
    kinetic = 0.5 * np.einsum("ki,kij,kj->k", s, inertia(theta, q), s)
    return np.asarray(kinetic + 0.5 * np.einsum("ki,ki->k", error, error) / Gamma)


# ---- O9: passivity ------------------------------------------------------------------------------


def passive_limit(theta: Sequence[float], q: Sequence[float], K: float, alpha: float) -> float:
    """O9, the largest λ_M for which the arm at `q` is passive to its operator, theta known, 1/s.

    dq/τ_h = (p + λ_M)/((M p + K)(p + α)) is positive real iff λ_M <= α + λ_min(K M⁻¹).
    """
    heaviest = np.linalg.eigvalsh(inertia(theta, np.array([q], dtype=np.float64))[0]).max()
    return float(alpha + K / heaviest)


def grip_limit(limit: float, K: float, alpha: float, k_p: float) -> float:
    """O9, λ_M at which an undamped grip k_p on such an arm begins to oscillate, 1/s.

    Routh on M p³ + (K + αM) p² + (αK + k_p) p + λ_M k_p: λ_M < `limit` (1 + αK/k_p), which goes
    to the passive limit as the grip gets stiff. With K = λ_c M̂ (Remark 3), αK is replaced by
    α λ_c times the smallest eigenvalue of M.
    """
    return limit * (1.0 + alpha * K / k_p)


# ---- Sec. V: consensus without lambda_M ---------------------------------------------------------


def consensus_without_integral(
    starts: ArrayLike, share: float, q_h: ArrayLike, K: float, alpha: float, k_p: float
) -> Array:
    """The approximate meeting point of six robots, λ_M = 0, with the operator on one of them, rad.

    q = (α q̄(0) + γ (k_p/K) q_h)/(α + γ k_p/K): `share` = γ is the weight of the held robot in
    the agreement (1/6 in a balanced graph, where q̄(0) is the mean of `starts` (6, 2)). The
    weights switch at random, so that this is a mean over seeds.
    """
    pull = share * k_p / K
    mean = np.asarray(starts, dtype=np.float64).mean(axis=0)
    return np.asarray((alpha * mean + pull * np.asarray(q_h)) / (alpha + pull))
