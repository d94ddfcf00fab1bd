"""Estimates of the peak velocities: the robots' linear behavior from their start positions.

Each joint is computed separately, with inertia M_jj at the start, estimate 0 in the feed-forward,
mean weights and no delays::

    M ddq = -K (dq - z) + k_p (q_h - q) - (k_d + D) dq
    dz    = -alpha dq + lambda_M (dq - z) - coupling

The estimate is accurate to about a factor of two.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from math import inf

import numpy as np

from cosim.predict.facts import Array
from cosim.predict.network import RobotNetwork, network
from cosim.predict.system import AnalyzedSystem

#: Doublings of the time step, and the first step, s: 2^9 steps of 20 ms.
_DOUBLINGS, _STEP = 9, 0.02
#: Robots beyond which each is moved by itself, with what it receives from the others.
MANY = 50


@dataclass(frozen=True, slots=True)
class Peaks:
    """Largest |dz| of each robot over time, (n,) rad/s², and |tau_i| of each joint, (n, m) N.m."""

    dz: Array
    tau: Array


def held_networks(system: AnalyzedSystem) -> Iterator[tuple[RobotNetwork, Peaks]]:
    """The networks with a held arm, each once, with their :func:`peaks`; none of Remark 3."""
    done: set[str] = set()
    for start in system.held():
        net = network(system, start)
        if net is None or net.law.lambda_c or net.names[0] in done:
            continue
        done.add(net.names[0])
        yield net, system.once("peaks", net.names[0], partial(peaks, net))


def peaks(net: RobotNetwork) -> Peaks:
    """Peak values of the robots of `net` when their grips pull them from their start positions."""
    n, M = len(net.laws), _inertia(net)
    dz, tau = np.zeros(n), np.zeros(M.shape)
    for j in range(M.shape[1]):
        K = np.array([law.K[j % len(law.K)] for law in net.laws])
        fastest, strongest = np.zeros(n), np.zeros(n)
        for states, rates in _motion(net, j, M[:, j]):
            s = states[..., n : 2 * n] - states[..., 2 * n :]
            np.maximum(fastest, np.abs(rates[..., 2 * n :]).max(axis=0), out=fastest)
            np.maximum(strongest, np.abs(K * s).max(axis=0), out=strongest)
        dz += fastest**2
        tau[:, j] = strongest
    return Peaks(np.sqrt(dz), tau)


def settling(net: RobotNetwork, within: float) -> float:
    """The time from which every joint at the port stays `within` rad of its hand's place, s.

    By the same motion of each joint alone; inf if it takes longer than the motion is computed for.
    """
    arm, last, M = net.arms[net.port], 0.0, _inertia(net)
    for j, place in enumerate(arm.grip.place):
        q = np.concatenate([states[:, net.port] for states, _ in _motion(net, j, M[:, j])])
        outside = np.flatnonzero(np.abs(q - place) > within)
        if len(outside):
            last = max(last, _STEP * (outside[-1] + 1))
    return last if last < _STEP * 2**_DOUBLINGS else inf


def _inertia(net: RobotNetwork) -> Array:
    """M_jj of the joints that all robots have, where they start, (n, m), kg.m2."""
    m = min(len(arm.q) for arm in net.arms)
    return np.array([np.diagonal(arm.inertia(arm.parameters, arm.q))[:m] for arm in net.arms])


def _motion(net: RobotNetwork, j: int, M: Array) -> Iterator[tuple[Array, Array]]:
    """States at 0, h, 2 h, ..., 2^9 of them, and their rates, (k, 3 n), k at once.

    x = (q, dq, z) of joint `j` of each robot, (3 n,), of inertia `M` (n,): dx/dt = A x + b.
    """
    A, b, x = _alone(net, j, M)
    if len(net.laws) > MANY:
        yield from _one_by_one(net, A, b, x)
        return
    n = len(net.laws)
    whole = np.zeros((3, n, 3, n))
    whole[:, np.arange(n), :, np.arange(n)] = A
    alpha = np.array([law.alpha for law in net.laws])
    C = np.zeros((n, n))
    np.add.at(C, (net.couplings.receivers, net.couplings.senders), net.couplings.strength)
    whole[2, :, 0] += C * alpha
    whole[2, :, 1] += C
    A = whole.reshape(3 * n, 3 * n)
    states = _doubled(A, b.T.ravel(), x.T.ravel())
    yield states, states @ A.T + b.T.ravel()


def _alone(net: RobotNetwork, j: int, M: Array) -> tuple[Array, Array, Array]:
    """(A, b, x(0)) of x = (q, dq, z) of joint `j`, (n, 3, 3) and (n, 3), without the others."""
    laws, arms = net.laws, net.arms
    K = np.array([law.K[j % len(law.K)] for law in laws])
    k_p = np.array([arm.grip.stiffness[j] for arm in arms])
    k_d = np.array([arm.grip.damping[j] + arm.friction[j] for arm in arms])
    q_h = np.array([arm.grip.place[j] for arm in arms])
    alpha = np.array([law.alpha for law in laws])
    lambda_M = np.array([law.lambda_M for law in laws])
    A, b, x = np.zeros((len(laws), 3, 3)), np.zeros((len(laws), 3)), np.zeros((len(laws), 3))
    A[:, 0, 1] = 1.0
    A[:, 1] = np.stack([-k_p / M, -(K + k_d) / M, K / M], axis=-1)
    A[:, 2] = np.stack([-(net.around * alpha), lambda_M - alpha - net.around, -lambda_M], axis=-1)
    b[:, 1] = k_p * q_h / M
    x[:, 0] = [arm.q[j] for arm in arms]
    return A, b, x


def _doubled(A: Array, b: Array, x: Array) -> Array:
    """The states of all robots together, (k, 3 n), by squaring one step over and over."""
    size = len(x)
    augmented = np.zeros((size + 1, size + 1))
    augmented[:size, :size], augmented[:size, size] = A, b
    step = _exponential(augmented * _STEP)
    states = np.append(x, 1.0)[None, :]
    for _ in range(_DOUBLINGS):
        states = np.concatenate([states, states @ step.T])
        step = step @ step
    return np.asarray(states[:, :size])


def _one_by_one(net: RobotNetwork, A: Array, b: Array, x: Array) -> Iterator[tuple[Array, Array]]:
    """The same for many robots: each exactly, but for what it receives from the others.

    That is taken as a line over each step, through its values now and one step before.
    """
    n, edges = len(x), net.couplings
    alpha = np.array([law.alpha for law in net.laws])
    # what a robot is driven by beside itself: its grip, what it receives, and how that changes
    driven = np.zeros((n, 6, 6))
    driven[:, :3, :3], driven[:, :3, 3], driven[:, 2, 4], driven[:, 4, 5] = A, b, 1.0, 1.0 / _STEP
    step = np.moveaxis(_exponential(driven * _STEP)[:, :3], 0, -1).copy()  # (3, 6, n)
    rate = np.moveaxis(driven[:, :3], 0, -1).copy()
    inputs = np.empty((6, n))
    inputs[:3], inputs[3] = x.T, 1.0
    for k in range(2**_DOUBLINGS):
        xi = inputs[1] + alpha * inputs[0]
        received = np.bincount(edges.receivers, edges.strength * xi[edges.senders], n)
        inputs[5] = received - inputs[4] if k else 0.0
        inputs[4] = received
        rates = (rate * inputs).sum(axis=1)
        yield inputs[:3].reshape(1, 3 * n).copy(), rates.reshape(1, 3 * n)
        inputs[:3] = (step * inputs).sum(axis=1)


def _exponential(A: Array) -> Array:
    """Exp A, (..., k, k), by the series of A/2^s, squared s times."""
    squarings = max(0, int(np.ceil(np.log2(max(1.0, np.abs(A).sum(axis=-1).max())))) + 3)
    term = total = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    for k in range(1, 12):
        term = term @ A / (k * 2.0**squarings)
        total = total + term
    for _ in range(squarings):
        total = total @ total
    return np.asarray(total)
