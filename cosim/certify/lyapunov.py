"""The search for a quadratic Lyapunov function of the loop with any ages, if they are few."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from cosim.certify.inequalities import Matrix, interior, symmetric
from cosim.certify.model import ClosedParts
from cosim.certify.switched import Ages, follow, modes, n_modes, switched

#: Combinations of ages and states up to which a common function is looked for (seconds).
MODES, STATES = 64, 24
#: Unknowns up to which one function for each combination is looked for.
_UNKNOWNS = 240


def size(parts: ClosedParts) -> tuple[int, int]:
    """Combinations of ages and states of the switched loop."""
    late = sum(x.most * x.size for x in parts.links)
    return n_modes(parts.links), len(parts.A) + late - len(parts.pivots)


def few(parts: ClosedParts) -> bool:
    """True if states and combinations of ages are few enough for a search."""
    n_m, n = size(parts)
    if any(x.sends > 1 for x in parts.links):
        return False
    return n_m <= MODES and 0 < n <= STATES


def candidates(parts: ClosedParts) -> Iterator[Mapping[Ages, Matrix]]:
    """A common P (n, n), without a unit, of all combinations of ages, then one for each."""
    if not few(parts):
        return
    n_m, n = size(parts)
    every = modes(parts.links)
    A = {m: np.array(switched(parts, m).floats()) for m in every}
    if any(np.abs(np.linalg.eigvals(a)).max() >= 1.0 for a in A.values()):
        return
    E = symmetric(n)
    weights = np.trace(E, axis1=1, axis2=2) / n
    x = interior([E, *(E - a.T @ E @ a for a in A.values())], weights)
    if x is not None:
        P = np.tensordot(x, E, 1)
        yield dict.fromkeys(every, P)
    if n_m * len(E) > _UNKNOWNS:
        return
    k = len(E)
    blocks = []
    for i, m in enumerate(every):
        own = np.zeros((n_m * k, n, n))
        own[i * k : (i + 1) * k] = E
        blocks.append(own)
        for j, o in enumerate(every):
            if follow(parts.links, m, o):
                falls = own.copy()
                falls[j * k : (j + 1) * k] -= A[m].T @ E @ A[m]
                blocks.append(falls)
    x = interior(blocks, np.tile(weights, n_m) / n_m)
    if x is not None:
        yield {m: np.tensordot(x[i * k : (i + 1) * k], E, 1) for i, m in enumerate(every)}
