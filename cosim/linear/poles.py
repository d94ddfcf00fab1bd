"""Poles of a large loop: those near z = 1, and near points of the unit circle, by sparse matrices.

Most states of a loop with long delays are samples on their way. All their eigenvalues would take
minutes and say little: a delay of d periods has d of them around the circle. Estimates and other
integrals that act by a few combinations only are replaced by these; the rest are poles at z = 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from cosim.base.errors import RunError
from cosim.linear.component import Matrix
from cosim.linear.pieces import Index

#: States from which on not all eigenvalues are computed.
LARGE = 1200
#: Poles that are looked for near z = 1, and near each of the points besides, of the upper half.
_NEAR, _BESIDES, _POINTS = 40, 6, 8
#: Distance from z = 1 of the first point: poles at 1 itself would make it singular.
_APART = 1e-3 + 1e-3j
_EQUAL = 1e-9
#: Poles that are closer are one; steps in which one must be found.
_SAME, _REFINEMENTS = 1e-7, 6


class Poles(NamedTuple):
    """Eigenvalues `z` (n,), and of each the state that takes the greatest part in it (n,).

    `integrals`: further eigenvalues at 1.
    """

    z: Matrix
    state: Index
    integrals: int


def near_the_circle(A: Matrix) -> Poles:
    """The poles of `A` (n, n) that are nearest to z = 1 and to points of the upper unit circle.

    Raises RunError without SciPy.
    """
    try:
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import eigs
    except ImportError:
        raise RunError(
            f"the poles of {len(A)} states need SciPy: pip install 'cosim-bridge[fit]'"
        ) from None
    small, states, integrals = _without_integrals(A)
    M = csc_array(small.astype(np.complex128))
    angles = np.pi * (np.arange(_POINTS) + 0.5) / _POINTS
    points = [1.0 + _APART, *np.exp(1j * angles)]
    found: dict[complex, int] = {}
    for k, point in enumerate(points):
        some = eigs(M, k=_BESIDES if k else _NEAR, sigma=point, return_eigenvectors=False)
        for guess in some:
            refined = _refined(M, complex(guess))
            if refined is None:
                continue
            z = complex(refined[0].real, abs(refined[0].imag))
            if all(abs(z - other) > _SAME for other in found):
                found[z] = refined[1]
    order = sorted(found, key=lambda z: -abs(z))
    at = states[[found[z] for z in order]]
    return Poles(np.array(order, dtype=np.complex128), at, integrals)


def _without_integrals(A: Matrix) -> tuple[Matrix, Index, int]:
    """The matrix with few integrals, the state that each of its rows stands for, and how many less.

    Integrals are states that stay as they are but for what others add: x+ = x + C y. What y gets
    of them is B x; of orthonormal combinations Q x with B = B Q'Q, there are as many as B has rank.
    """
    candidates = np.flatnonzero(np.abs(np.diag(A) - 1.0) < _EQUAL)
    block = A[np.ix_(candidates, candidates)] - np.eye(len(candidates))
    own = candidates[(np.abs(block) < _EQUAL).all(axis=1)]
    rest = np.setdiff1d(np.arange(len(A)), own)
    if not len(own):
        return A, rest, 0
    B = A[np.ix_(rest, own)]
    _, values, Q = np.linalg.svd(B[np.any(B != 0.0, axis=1)], full_matrices=False)
    Q = Q[values > _EQUAL * max(values.max(initial=0.0), 1e-300)]
    top = np.hstack([A[np.ix_(rest, rest)], B @ Q.T])
    bottom = np.hstack([Q @ A[np.ix_(own, rest)], np.eye(len(Q))])
    named = own[np.abs(Q).argmax(axis=1)] if len(Q) else own[:0]
    return np.vstack([top, bottom]), np.concatenate([rest, named]), len(own) - len(Q)


def _refined(M: Any, z: complex) -> tuple[complex, int] | None:
    """A pole from the guess `z`, and the state with the greatest part in it; None: there is none.

    By inverse iteration on both sides. A loop with delays is far from normal, and guesses for its
    faster poles can be far off, although M v is close to z v.
    """
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import splu

    n = M.shape[0]
    right = np.ones(n, np.complex128)
    left = right.copy()
    for _ in range(_REFINEMENTS):
        solve = splu(csc_array(M - (z + _EQUAL) * eye_array(n, dtype=np.complex128))).solve
        for _ in range(2):
            right, left = solve(right), solve(left, trans="H")
            right, left = right / np.linalg.norm(right), left / np.linalg.norm(left)
        last, z = z, complex((left.conj() @ (M @ right)) / (left.conj() @ right))
        if abs(z - last) < _SAME / 10:
            return z, int(np.abs(right * left.conj()).argmax())
    return None
