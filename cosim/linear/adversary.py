"""The greedy adversary: at each period the samples with which links drive a linear model most.

The links of the model are cut, x+ = A x + B u, y = C x + D u (:mod:`cosim.linear.opened`), and a
receiver may hold any of some samples that were sent. Of these the adversary takes the one that
gives most power to an energy V: the one with the greatest (dV/du) u. V is x' P x of the states or
of their change, where P is the identity or the Lyapunov matrix of the loop without links; or
|l z|^2, the amplitude of the slowest mode with the oldest samples, where z is the states and what
was sent before, and l the left eigenvector.

Source: own construction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cosim.linear.component import Matrix
from cosim.linear.pieces import Index

#: A, B, C and D.
Matrices = tuple[Matrix, Matrix, Matrix, Matrix]
#: Times before, s, since which the change of a state is taken; 0: the state itself.
BACK = (0.0, 1e-6, 0.05, 0.2)
#: The factor that keeps the energy of a loop without damping finite.
DAMPED = 0.999
#: States at which the model is scaled down again.
FAR = 1e9
#: States and values on their way up to which the slowest mode is an aim (1 s).
LIFTED = 700
#: The distance from 1 below which a pole is neutral.
NEUTRAL = 1e-6


@dataclass(frozen=True, slots=True)
class SampleChoices:
    """The samples that a receiver may hold, from new to old.

    With sample o the inputs `places` (w,) are the outputs `which` (o, w) of `before` (o, w) periods
    ago; those of the present period must not depend on u. `grows`: the number of the sample grows
    by at most this a period; None: by any.
    """

    places: Index
    which: Index
    before: Index
    grows: int | None = None


@dataclass(frozen=True, slots=True)
class Attack:
    """The samples `chosen` of each receiver, numbers (periods,), to reach the aim `says`.

    `size`: the logarithm of the greatest change of a state in each period, (periods,).
    """

    says: str
    chosen: tuple[Index, ...]
    size: Matrix


@dataclass(frozen=True, slots=True)
class _Aim:
    """An aim: the u that are held make (z' `power` + r' `past`) u large.

    z (n,) is the state, or its change since `back` periods before; r (d p,) is what was sent in the
    last d periods, the newest first. `power` (n, m), `past` (d p, m).
    """

    says: str
    power: Matrix
    back: int = 0
    past: Matrix | None = None


def attacks(
    model: Matrices, receivers: Sequence[SampleChoices], start: Matrix, periods: int, period: float
) -> list[Attack]:
    """An attack for each aim: the motion of `periods` (of `period` s each) from `start` (n,)."""
    A, B, C, D = model
    deepest = max(int(r.before.max()) for r in receivers)
    aims = [*_energies(A, B, C, period), *_slowest_mode(model, receivers, deepest)]
    n, longest = len(aims), max(1, *(aim.back for aim in aims))
    x = np.tile(start, (n, longest + 1, 1))  # (aims, times: the last is now, states)
    y, u = np.zeros((n, deepest + periods, len(C))), np.zeros((n, B.shape[1]))
    y[:, :deepest] = C @ start
    chosen = [np.zeros((n, periods), np.intp) for _ in receivers]
    size, scale = np.zeros((n, periods)), np.zeros(n)
    power, rows = np.stack([aim.power for aim in aims]), np.arange(n)
    back = np.array([aim.back for aim in aims])
    for k in range(periods):
        now = deepest + k
        y[:, now] = x[:, -1] @ C.T
        moves = x[:, -1] - np.where(back[:, None] > 0, x[rows, longest - back], 0.0)
        gain = np.einsum("cn,cnm->cm", moves, power)
        for i, aim in enumerate(aims):
            if aim.past is not None:
                gain[i] += y[i, now - deepest + 1 : now + 1][::-1].reshape(-1) @ aim.past
        for r, mine in zip(receivers, chosen, strict=True):
            held = y[:, now - r.before, r.which]  # (aims, samples, inputs)
            value = np.einsum("cow,cw->co", held, gain[:, r.places])
            if r.grows is not None and k:
                older = np.arange(len(r.before)) > mine[:, k - 1, None] + r.grows
                value[older] = -np.inf
            best = value.argmax(1)
            mine[:, k], u[:, r.places] = best, held[rows, best]
        y[:, now] += u @ D.T
        x = np.concatenate([x[:, 1:], (x[:, -1] @ A.T + u @ B.T)[:, None]], axis=1)
        with np.errstate(divide="ignore"):
            size[:, k] = np.log(np.abs(x[:, -1] - x[:, -2]).max(axis=1)) + scale
        most = np.abs(x).max(axis=(1, 2))
        for i in np.flatnonzero((most > FAR) | (most < 1.0 / FAR) & (most > 0.0)).tolist():
            with np.errstate(over="ignore"):  # of what was long before
                x[i], y[i], u[i] = x[i] / most[i], y[i] / most[i], u[i] / most[i]
            scale[i] += np.log(most[i])
    return [
        Attack(aim.says, tuple(mine[i] for mine in chosen), size[i]) for i, aim in enumerate(aims)
    ]


def _energies(A: Matrix, B: Matrix, C: Matrix, period: float) -> list[_Aim]:
    radius = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    inside = A * min(1.0, DAMPED / max(radius, 1e-12))
    weights = {
        "of states": np.eye(len(A)),
        "kept by states": _lyapunov(inside, np.eye(len(A))),
        "kept by outputs": _lyapunov(inside, C.T @ C),
    }
    found = []
    for what, P in weights.items():
        for held in BACK:
            back = max(1, round(held / period)) if held else 0
            says = f"the energy {what}"
            says += f", by their change in {back * period:.3g} s" if back else ""
            found.append(_Aim(says, P @ B, back))
    return found


def _lyapunov(A: Matrix, Q: Matrix) -> Matrix:
    """P = Q + A' P A, by doubling."""
    P, power = Q.copy(), A.copy()
    for _ in range(40):
        more = power.T @ P @ power
        P = P + more
        power = power @ power
        if np.abs(more).max() <= 1e-12 * np.abs(P).max():
            break
    return P


def _slowest_mode(model: Matrices, receivers: Sequence[SampleChoices], depth: int) -> list[_Aim]:
    """The amplitude of the slowest mode with the oldest samples, if the loop has few states."""
    A, B, C, D = model
    n, p = len(A), len(C)
    if n + depth * p > LIFTED:
        return []
    E = np.zeros((B.shape[1], n + depth * p))  # u = E z
    for r in receivers:
        for place, y, before in zip(
            *(x.tolist() for x in (r.places, r.which[-1], r.before[-1])), strict=True
        ):
            if before:
                E[place, n + (before - 1) * p + y] = 1.0
            else:
                E[place, :n] = C[y]
    into = np.zeros((n + depth * p, B.shape[1]))
    F = np.zeros((n + depth * p, n + depth * p))
    F[:n, :n], into[:n] = A, B
    if depth:
        F[n : n + p, :n], into[n : n + p] = C, D
        F[n + p :, n:-p] = np.eye((depth - 1) * p)
    values, vectors = np.linalg.eig((F + into @ E).T)
    size = np.where(np.abs(values - 1.0) < NEUTRAL, 0.0, np.abs(values))
    if not size.max(initial=0.0):
        return []
    mode = vectors[:, int(size.argmax())]
    # |l z|^2 has the derivative 2 Re(conj(l z) l B) by u, here with z without u
    act = np.outer(mode.conj(), mode @ into).real
    return [_Aim("the amplitude of the slowest mode", A.T @ act[:n], 0, act[n:])]
