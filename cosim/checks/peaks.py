"""Estimates of the peak velocities: the robots' linear behavior from their start positions.

Each joint is computed separately, with inertia M_jj at the start, estimate 0 in the feed-forward,
mean weights and no delays::

    M ddq = -K (dq - z) + k_p (q_h - q) - (k_d + D) dq
    dz    = -alpha dq + lambda_M (dq - z) - coupling

The estimate is accurate to about a factor of two.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from cosim.analysis.facts import Array
from cosim.analysis.network import RobotNetwork
from cosim.analysis.system import AnalyzedSystem

#: Doublings of the time step, and the first step, s: 2^9 steps of 20 ms.
_DOUBLINGS, _STEP = 9, 0.02
#: States beyond which matrices are taken as sparse.
DENSE = 300


@dataclass(frozen=True, slots=True)
class Peaks:
    """Of each robot, (n,): largest |dz| over time, rad/s², and |tau_i| of a joint, N.m."""

    dz: Array
    tau: Array


def peaks_of(system: AnalyzedSystem, port: str, net: RobotNetwork) -> Peaks:
    """The :func:`peaks` of the network of the arm `port`, computed once."""
    return system.once("peaks", port, lambda: peaks(net))


def peaks(net: RobotNetwork) -> Peaks:
    """Peak values of the robots of `net` when their grips pull them from their start positions."""
    n, m = len(net.laws), min(len(arm.q) for arm in net.arms)
    dz, tau = np.zeros(n), np.zeros(n)
    for j in range(m):
        A, b, x = _linear(net, j)
        states = _states(A, b, x)
        rates = states @ A.T + b
        K = np.array([law.K[j % len(law.K)] for law in net.laws])
        dz += np.abs(rates[:, 2 * n :]).max(axis=0) ** 2
        s = states[:, n : 2 * n] - states[:, 2 * n :]
        tau = np.maximum(tau, np.abs(K * s).max(axis=0))
    return Peaks(np.sqrt(dz), tau)


def settling(net: RobotNetwork, within: float) -> float:
    """When every joint at the port stays within so many rad of the place of its hand, s.

    By the same motion of each joint alone; inf if it takes longer than the motion is computed for.
    """
    arm, last = net.arms[net.port], 0.0
    for j, place in enumerate(arm.grip.place):
        states = _states(*_linear(net, j))
        outside = np.flatnonzero(np.abs(states[:, net.port] - place) > within)
        if len(outside):
            last = max(last, _STEP * (outside[-1] + 1))
    return last if last < _STEP * 2**_DOUBLINGS else inf


def _linear(net: RobotNetwork, j: int) -> tuple[Array, Array, Array]:
    """(A, b, x(0)) of dx/dt = A x + b, x = (q, dq, z) of joint `j`, (3 n,)."""
    n, laws, arms = len(net.laws), net.laws, net.arms
    M = np.array([arm.inertia(arm.parameters, arm.q)[j, j] for arm in arms])
    K = np.array([law.K[j % len(law.K)] for law in laws])
    k_p = np.array([arm.grip.stiffness[j] for arm in arms])
    k_d = np.array([arm.grip.damping[j] + arm.friction[j] for arm in arms])
    q_h = np.array([arm.grip.place[j] for arm in arms])
    alpha = np.array([law.alpha for law in laws])
    lambda_M = np.array([law.lambda_M for law in laws])
    around = net.coupling.sum(axis=1) + net.outside
    if 3 * n > DENSE:
        from scipy.sparse import block_array as block
        from scipy.sparse import csr_array, diags_array, eye_array

        diagonal, one = diags_array, eye_array(n)
        L = diags_array(around) - csr_array(net.coupling)
    else:
        block, diagonal, one = np.block, np.diag, np.eye(n)
        L = np.diag(around) - net.coupling
    none = diagonal(np.zeros(n))
    A = block([
        [none, one, none],
        [diagonal(-k_p / M), diagonal(-(K + k_d) / M), diagonal(K / M)],
        [-(L @ diagonal(alpha)), diagonal(lambda_M - alpha) - L, diagonal(-lambda_M)],
    ])  # fmt: skip
    b = np.concatenate([np.zeros(n), k_p * q_h / M, np.zeros(n)])
    x = np.concatenate([[arm.q[j] for arm in arms], np.zeros(2 * n)])
    return A, b, x


def _states(A: Array, b: Array, x: Array) -> Array:
    """States at 0, h, 2 h, ..., 2^9 of them, (k, 3 n), by squaring one step over and over."""
    size = len(x)
    if size > DENSE:
        return _sparse_states(A, b, x)
    augmented = np.zeros((size + 1, size + 1))
    augmented[:size, :size], augmented[:size, size] = A, b
    step = _exponential(augmented * _STEP)
    states = np.append(x, 1.0)[None, :]
    for _ in range(_DOUBLINGS):
        states = np.concatenate([states, states @ step.T])
        step = step @ step
    return np.asarray(states[:, :size])


def _sparse_states(A: Array, b: Array, x: Array) -> Array:
    """The same for many robots, whose A is almost empty: from each state to the next."""
    from scipy.sparse import block_array, csr_array
    from scipy.sparse.linalg import expm_multiply

    column = csr_array(b[:, None])
    augmented = csr_array(block_array([[A, column], [None, csr_array((1, 1))]]) * _STEP)
    steps = 2**_DOUBLINGS
    states = expm_multiply(augmented, np.append(x, 1.0), 0.0, steps - 1.0, steps, endpoint=True)
    return np.asarray(states[:, :-1])


def _exponential(A: Array) -> Array:
    """Exp A, by the series of A/2^s, squared s times."""
    squarings = max(0, int(np.ceil(np.log2(max(1.0, np.abs(A).sum(axis=1).max())))) + 3)
    term = total = np.eye(len(A))
    for k in range(1, 12):
        term = term @ A / (k * 2.0**squarings)
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return np.asarray(total)
