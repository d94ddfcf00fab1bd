"""The search for a small-gain certificate: scales of the links, then a storage function.

With w_i bounded by g_i v_i in the norm weighted by any X_i > 0 (:mod:`cosim.certify.nominal`) the
loop is stable if the gain from w to v, so weighted, is below 1. X = diag(X_i) comes from linear
matrix inequalities on a grid of frequencies, and P of the Kalman-Yakubovich-Popov lemma from a
Riccati equation, which takes little time for a hundred states. Nothing here is trusted: a candidate
counts if :mod:`cosim.certify.checker` accepts it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from cosim.certify.inequalities import interior, symmetric
from cosim.certify.nominal import Nominal

Matrix = NDArray[np.float64]
#: Frequencies of the grid, and at most of those near poles.
_GRID, _POLES = 60, 40
#: Numbers on links up to which each has a matrix of its own.
_MATRICES = 16
#: The distance from the limit that P keeps, relative.
_ROOM = (1e-3, 1e-5, 1e-7)


def candidates(found: Nominal, squared: Sequence[float]) -> Iterator[tuple[Matrix, list[Matrix]]]:
    """P (n, n) and the X_i, without units, for g_i^2 = `squared` (samples squared), if any."""
    F, V = (np.array(x.floats()).reshape(len(x), x.width) for x in (found.F, found.V))
    n = len(F)
    A, B, C, D = F[:, :n], F[:, n:], V[:, :n], V[:, n:]
    z = _grid(A) if n else None
    if z is None:
        return
    T = C @ np.linalg.solve(z[:, None, None] * np.eye(n) - A, np.broadcast_to(
        B.astype(np.complex128), (len(z), *B.shape))) + D  # fmt: skip
    X = _scales(T, found, squared)
    if X is None:
        return
    for room in _ROOM:
        P = _riccati(A, B, C, D, X, _weighted(X, found, squared), room)
        if P is not None:
            yield P, [X[np.ix_(p, p)] for p in found.places]


def _grid(A: Matrix) -> NDArray[np.complex128] | None:
    """Points of the upper half of the unit circle; None if the loop is not stable."""
    poles = np.linalg.eigvals(A)
    if not len(poles) or np.abs(poles).max() >= 1.0:
        return None
    near = np.sort(np.abs(np.angle(poles[np.argsort(-np.abs(poles))[:_POLES]])))
    angles = np.concatenate([[0.0], np.geomspace(1e-5, np.pi, _GRID), near])
    return np.exp(1j * np.unique(angles))


def _weighted(X: Matrix, found: Nominal, squared: Sequence[float]) -> Matrix:
    """g_i^2 X_i for each increment of each link, on the diagonal."""
    G = np.zeros((len(found.V), len(found.V)))
    for place, steps, g in zip(found.places, found.steps, squared, strict=True):
        own = X[place.start : place.stop, place.start : place.stop] * g
        for i in range(0, len(steps), len(place)):
            at = slice(steps[i], steps[i] + len(place))
            G[at, at] = own
    return G


def _scales(T: NDArray[np.complex128], found: Nominal, squared: Sequence[float]) -> Matrix | None:
    """X with T* diag(g_i^2 X_i) T < X at every point, T (k, p, m), as far from it as possible."""
    m = T.shape[2]
    if m > _MATRICES:
        return _numbers(T, found, squared)
    basis = []
    for place in found.places:
        own = symmetric(len(place))
        some = np.zeros((len(own), m, m))
        some[:, place.start : place.stop, place.start : place.stop] = own
        basis.append(some)
    E = np.concatenate(basis)
    G = np.array([_weighted(e, found, squared) for e in E])
    inside = E[:, None] - T.conj().transpose(0, 2, 1) @ G[:, None] @ T
    whole = np.block([[inside.real, -inside.imag], [inside.imag, inside.real]])
    x = interior([E, *whole.transpose(1, 0, 2, 3)], np.trace(E, axis1=1, axis2=2) / m)
    return None if x is None else np.asarray(np.tensordot(x, E, 1))


def _numbers(T: NDArray[np.complex128], found: Nominal, squared: Sequence[float]) -> Matrix | None:
    """X_i = x_i I by the Perron vectors l, r of N, the greatest gains from link to link: x = l/r.

    The norm of D N / D, D = sqrt(x), is then the spectral radius of N, its least value.
    """
    gains = np.array([
        [np.linalg.norm(T[:, rows][:, :, place], 2, axis=(1, 2)).max() for place in found.places]
        for rows in found.steps
    ])  # fmt: skip
    N = np.sqrt(squared)[:, None] * gains + 1e-9
    (radius, right), (_, left) = (_greatest(x) for x in (N, N.T))
    if radius >= 1.0:
        return None
    sizes = [len(place) for place in found.places]
    return np.diag(np.repeat(left / right, sizes))


def _greatest(N: Matrix) -> tuple[float, Matrix]:
    """The greatest eigenvalue of a positive matrix, and its vector."""
    values, vectors = np.linalg.eig(N)
    first = int(np.argmax(values.real))
    return float(values[first].real), np.abs(vectors[:, first])


def _riccati(
    A: Matrix, B: Matrix, C: Matrix, D: Matrix, X: Matrix, G: Matrix, room: float
) -> Matrix | None:
    """P of the bounded real lemma, with `room` added to what must be negative."""
    from scipy.linalg import solve_discrete_are

    scale = float(np.trace(C.T @ G @ C) or np.trace(C.T @ C)) / len(A)
    Q = C.T @ G @ C + room * scale * np.eye(len(A))
    R = D.T @ G @ D - X * (1.0 - room)
    try:
        P = solve_discrete_are(A, B, Q, R, s=C.T @ G @ D)
    except (np.linalg.LinAlgError, ValueError):
        return None
    return np.asarray((P + P.T) / 2) if np.isfinite(P).all() else None
