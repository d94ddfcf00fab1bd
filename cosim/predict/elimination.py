"""Columns of the inverse of a matrix of blocks that is almost empty: one block a robot and an edge.

The robots of a network are coupled along its edges only, so that elimination in a good order takes
a time that grows little faster than their number, and no matrix of all pairs is ever made.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError

Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

#: Rows up to which some hundred columns take seconds, by whether SciPy is installed.
QUICK = {True: 5000, False: 400}
#: Rows up to which the matrix is made whole where SciPy is not installed.
WITHOUT_SCIPY = 3000


def quick_rows() -> int:
    """The rows up to which some hundred columns take seconds."""
    return QUICK[find_spec("scipy") is not None]


def column(own: Complex, coupled: Complex, rows: Indices, columns: Indices, at: int) -> Complex:
    """The blocks of A⁻¹ in the block column `at`, (n, m, m).

    A has the blocks `own` (n, m, m) on its diagonal, and `coupled` (edges, m, m) is added at the
    block rows `rows` and block columns `columns`, (edges,) each. Raises ScenarioError for a matrix
    of more than :data:`WITHOUT_SCIPY` rows if SciPy is not installed.
    """
    n, m = own.shape[:2]
    unit = np.zeros((n * m, m), dtype=np.complex128)
    unit[at * m : (at + 1) * m] = np.eye(m)
    try:
        from scipy.sparse import csc_array
        from scipy.sparse.linalg import splu
    except ImportError:
        found: Any = np.linalg.solve(_whole(own, coupled, rows, columns), unit)
        return np.asarray(found.reshape(n, m, m))
    i = np.concatenate([np.arange(n), rows])[:, None, None] * m + np.arange(m)[:, None]
    j = np.concatenate([np.arange(n), columns])[:, None, None] * m + np.arange(m)
    values = np.concatenate([own, coupled])
    places = [np.broadcast_to(x, values.shape).ravel() for x in (i, j)]
    A = csc_array((values.ravel(), (places[0], places[1])), shape=(n * m, n * m))
    factors = splu(
        A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True}
    )
    return np.asarray(factors.solve(unit)).reshape(n, m, m)


def _whole(own: Complex, coupled: Complex, rows: Indices, columns: Indices) -> Complex:
    n, m = own.shape[:2]
    if n * m > WITHOUT_SCIPY:
        raise ScenarioError(
            f"closed forms of {n} robots need SciPy: pip install 'cosim-bridge[fit]'"
        )
    blocks = np.zeros((n, n, m, m), dtype=np.complex128)
    blocks[np.arange(n), np.arange(n)] = own
    np.add.at(blocks, (rows, columns), coupled)
    return np.asarray(blocks.swapaxes(1, 2).reshape(n * m, n * m))
