"""Linear matrix inequalities, solved by Clarabel, an interior-point method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def symmetric(n: int) -> Matrix:
    """The basis of symmetric matrices, (k, n, n) with k = n(n + 1)/2, without a unit."""
    found = np.zeros((n * (n + 1) // 2, n, n))
    i, j = np.triu_indices(n)
    k = np.arange(len(i))
    found[k, i, j] = found[k, j, i] = 1.0
    return found


def interior(inequalities: Sequence[Matrix], weights: Matrix) -> Matrix | None:
    """Factors x (n,) with sum_i x_i F_i > 0 for each F (n, k, k) of `inequalities`, well inside.

    `weights` (n,), without a unit: weights . x = 1. The least eigenvalue t of all sums is as great
    as possible. None if t is not above 0, or the solver fails.
    """
    import clarabel as module
    from scipy.sparse import csc_array

    n = len(weights)
    sizes = [F.shape[1] for F in inequalities]
    rows = [np.append(weights, 0.0)[None]]
    for F, k in zip(inequalities, sizes, strict=True):
        i, j = np.triu_indices(k)
        order = np.lexsort((i, j))  # column by column
        i, j = i[order], j[order]
        factor = np.where(i == j, 1.0, np.sqrt(2.0))
        own = (F[:, i, j] * factor).T
        rows.append(np.hstack([-own, (i == j).astype(float)[:, None]]))
    A = csc_array(np.vstack(rows))
    b = np.zeros(A.shape[0])
    b[0] = 1.0
    cones = [module.ZeroConeT(1), *(module.PSDTriangleConeT(k) for k in sizes)]
    settings = module.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    nothing = csc_array((n + 1, n + 1))
    goal = np.append(np.zeros(n), -1.0)
    found = module.DefaultSolver(nothing, goal, A, b, cones, settings).solve()
    x = np.array(found.x)
    return x[:n] if len(x) and np.isfinite(x).all() and x[n] > 0.0 else None
