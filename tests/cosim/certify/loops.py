"""Loops with known limits, and an adversary that chooses their delays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cosim.certify.exact import Exact
from cosim.certify.model import CutLoop, LinkBounds

Matrix = NDArray[np.float64]


def exact(rows: object) -> Exact:
    found = np.atleast_2d(np.asarray(rows, float))
    return Exact.of(found.tolist(), found.shape[1])


def cut(
    A: object, B: object, C: object, links: Sequence[LinkBounds], neutral: object = None,
    period: float = 1.0,
) -> CutLoop:  # fmt: skip
    a, b, c = exact(A), exact(B), exact(C)
    X = Exact.zeros(len(a), 0) if neutral is None else exact(neutral)
    return CutLoop(a, b, c, Exact.zeros(len(c), len(c)), X, tuple(links), period)


def integrator(gain: float, greatest: int, least: int = 0) -> CutLoop:
    """x[k+1] = x[k] - gain x[k - age]."""
    return cut([[1.0]], [[-gain]], [[1.0]], [LinkBounds("link", 1, least, greatest)])


def masses(
    period: float, links: Sequence[LinkBounds], spring: float = 10.0, damping: float = 3.0
) -> CutLoop:
    """Two masses of 1 kg, each held by a spring to the delayed other, and a damper to the ground.

    P+d of Lee and Spong (2006), sampled with held forces: stable for constant delays T, and by
    Nuño et al. (2009) for varying ones, if the damping exceeds T times the spring.
    """
    T, K, B = period, spring, damping
    own = np.array([[1.0, T], [0.0, 1.0]])
    pushed = np.array([[T * T / 2.0], [T]])
    A1 = own - pushed @ np.array([[K, B]])
    A, Z = np.kron(np.eye(2), A1), np.zeros((2, 1))
    inputs = np.block([[K * pushed, Z], [Z, K * pushed]])
    return cut(A, inputs, [[0, 0, 1, 0], [1, 0, 0, 0]], links, [[1.0], [0.0], [1.0], [0.0]], T)


def both(least: int, greatest: int, ordered: bool = False) -> list[LinkBounds]:
    return [LinkBounds(name, 1, least, greatest, ordered) for name in ("there", "back")]


def growth(loop: CutLoop, ages: Sequence[Sequence[int]]) -> float:
    """The spectral radius of one cycle of `ages` (steps, links) to the power 1/steps.

    Without the neutral directions: those of what is sent are differences from the first link.
    """
    A, B, C = (np.array(x.floats()).reshape(len(x), x.width) for x in (loop.A, loop.B, loop.C))
    X = np.array(loop.neutral.floats()).reshape(len(A), -1)
    n, m, depth = len(A), len(C), max(max(row) for row in ages)
    gone = np.vstack([X, *[C @ X] * depth])
    Q = np.linalg.svd(gone, full_matrices=True)[0][:, gone.shape[1] :]
    product = np.eye(Q.shape[1])
    for row in ages:
        u = np.zeros((m, n + depth * m))
        for i, age in enumerate(row):
            place = slice(0, n) if age == 0 else n + (age - 1) * m + i
            u[i, place] = C[i] if age == 0 else 1.0
        F = np.zeros((n + depth * m, n + depth * m))
        F[:n, :n] = A
        F[:n] += B @ u
        if depth:
            F[n : n + m, :n] = C
            F[n + m :, n:-m] = np.eye((depth - 1) * m)
        product = Q.T @ F @ Q @ product
    return float(np.abs(np.linalg.eigvals(product)).max()) ** (1.0 / len(ages))
