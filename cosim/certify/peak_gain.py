"""The search for a certificate by peak gains: sums of impulse responses, then weights.

Nothing here is trusted: a candidate counts if :mod:`cosim.certify.peaks` accepts it.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import numpy as np

from cosim.certify.inequalities import Matrix
from cosim.certify.model import OpenParts

#: Steps of the impulse responses at most, and the distance from 1 that a gain keeps.
_STEPS, _ROOM = 40_000, 1e-3


def candidates(parts: OpenParts) -> Iterator[tuple[Matrix, Fraction, list[Fraction]]]:
    """P (n, n), rho and the weights (m,), or nothing."""
    A, B, C, D = (
        np.array(x.floats()).reshape(len(x), x.width) for x in (parts.A, parts.B, parts.C, parts.D)
    )
    radius = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    if not len(A) or radius >= 1.0:
        return
    H, x = np.abs(D), B
    for _ in range(_STEPS):
        part = np.abs(C @ x)
        H, x = H + part, A @ x
        if part.max() < 1e-9 * H.max(initial=1e-9):
            break
    greatest = np.zeros((B.shape[1], B.shape[1]))
    np.maximum.at(greatest, np.array(parts.sources, np.intp), H)
    values, vectors = np.linalg.eig(greatest + 1e-9)
    first = int(np.argmax(values.real))
    if values[first].real > 1.0 - _ROOM:
        return
    weights = np.abs(vectors[:, first].real)
    rho = 1.0 - 0.5 * (1.0 - radius)
    scale = float(np.trace(C.T @ C)) / len(A)
    Q = C.T @ C + 1e-3 * scale * np.eye(len(A))
    from scipy.linalg import solve_discrete_lyapunov

    P = solve_discrete_lyapunov(A.T / rho, Q)
    yield (
        P,
        Fraction(rho).limit_denominator(1 << 20),
        [Fraction(w / weights.max() + 1e-6).limit_denominator(1 << 20) for w in weights.tolist()],
    )
