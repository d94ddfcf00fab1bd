"""A frequency response at many points, from its values at few.

Along p = s + iω with s > 0 a response has no pole. In u = asinh(ω/s) its real poles are π/2 away
from the real axis, however slow they are, so that Chebyshev's polynomials in u converge at a rate
that does not depend on them. G(conj p) = conj G(p) gives the half with ω < 0.

Source: own construction from the theory of Chebyshev interpolation (Trefethen, Approximation Theory
and Approximation Practice, 2013, ch. 5 and 8).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]
Array = NDArray[np.float64]

#: Intervals between the points at first and at the most.
FEWEST, MOST = 32, 1024
#: The error at the next, finer points that is small enough, as a share of the greatest |G|.
ENOUGH = 1e-8


def interpolated(G: Callable[[Complex], Complex], p: Complex) -> Complex:
    """`G` at `p` (k,), (k, ...): points p = s + iω with one s > 0 and 0 <= ω ascending.

    `G` is called with some of the points in between: with twice as many until the values found are
    those that the points before predict, and with all of `p` where that takes too many.
    """
    s = float(p[0].real)
    u = np.arcsinh(p.imag / s)

    def values(at: Array) -> Complex:
        return G(np.asarray(s + 1j * s * np.sinh(at), dtype=np.complex128))

    n = FEWEST
    known = values(_nodes(n, u[-1]))
    while 2 * n <= min(MOST, len(p)):
        fine = _nodes(2 * n, u[-1])
        found = np.empty((n + 1, *known.shape[1:]), dtype=np.complex128)
        found[::2], found[1::2] = known, values(fine[1::2])
        wrong = np.abs(_between(known, fine[1::2], u[-1]) - found[1::2]).max()
        n, known = 2 * n, found
        if wrong <= ENOUGH * np.abs(known).max():
            return _between(known, u, u[-1])
    return G(p)


def _nodes(n: int, end: float) -> Array:
    """The points u >= 0 of n intervals from -`end` to `end`, from the last one to 0, (n/2 + 1,)."""
    return end * np.cos(np.pi * np.arange(n // 2 + 1) / n)


def _between(known: Complex, u: Array, end: float) -> Complex:
    """The values at `u` (k,) of the polynomial through `known` at :func:`_nodes`, (k, ...)."""
    half = len(known) - 1
    x = np.concatenate([_nodes(2 * half, end), -_nodes(2 * half, end)[-2::-1]])
    y = np.concatenate([known, np.conj(known[-2::-1])])
    weight = (-1.0) ** np.arange(len(x))
    weight[[0, -1]] /= 2
    apart = u[:, None] - x
    row, node = np.nonzero(np.abs(apart) <= 1e-12 * end)
    apart[row, node] = 1.0
    share = weight / apart
    share[row] = 0.0
    share[row, node] = 1.0
    share /= share.sum(axis=1, keepdims=True)
    return np.asarray(np.tensordot(share, y, axes=(1, 0)))
