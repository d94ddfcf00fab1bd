"""Errors of a measured signal that depend on those before: their covariances, and how many count.

The residuals of a signal are taken as an autoregressive process, whose order Akaike's criterion
chooses; its coefficients follow from the covariances of neighbours (Yule and Walker). The process,
not the noisy covariances themselves, then gives the covariance at every distance.

Source: P. Brockwell and R. Davis, Time Series: Theory and Methods, Springer 1991, Sec. 8.1 and 9.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Highest order of a process.
ORDER = 8


@dataclass(frozen=True, slots=True)
class CorrelatedErrors:
    """`covariance` (m,): of errors so many values apart, in the square of their unit."""

    covariance: Array

    @property
    def independent(self) -> float:
        """Values whose mean would be as certain if their errors were independent, 1 to m.

        Covariances count up to the first that is not positive: later ones swing, since a fit
        takes the mean of the errors.
        """
        c, m = self.covariance, self.covariance.size
        if c[0] <= 0.0:
            return float(m)
        end = int(np.argmax(np.append(c, 0.0) <= 0.0))
        total = c[0] + 2.0 * float((1.0 - np.arange(1, end) / m) @ c[1:end])
        return float(max(1.0, m * c[0] / total))

    def spread(self, J: Array) -> Array:
        """J^T C J (n, n) for the errors' covariance C and `J` (m, n), in the squares of units."""
        m = len(J)
        n = 1 << (2 * m - 1).bit_length()
        both = np.concatenate([self.covariance, np.zeros(n - 2 * m + 1), self.covariance[:0:-1]])
        power = np.fft.rfft(both)
        C_J = np.fft.irfft(power[:, None] * np.fft.rfft(J, n, axis=0), n, axis=0)[:m]
        found = J.T @ C_J
        return np.asarray(0.5 * (found + found.T))


def errors_of(r: Array) -> CorrelatedErrors:
    """The errors that left the residuals `r` (m,), in their unit."""
    m = r.size
    n = 1 << (2 * m - 1).bit_length()
    c = np.fft.irfft(np.abs(np.fft.rfft(r, n)) ** 2, n)[: min(m, ORDER + 1)] / m
    found = np.zeros(m)
    found[0] = c[0]
    if c[0] <= 0.0 or m < 4 * ORDER:
        return CorrelatedErrors(found)
    phi, best = np.zeros(0), (m * float(np.log(c[0])), np.zeros(0))
    left = float(c[0])
    for order in range(1, c.size):  # Levinson and Durbin
        k = float(c[order] - phi @ c[order - 1 : 0 : -1]) / left if order > 1 else c[1] / c[0]
        phi = np.append(phi - k * phi[::-1], k)
        left = max(left * (1.0 - k * k), 1e-12 * float(c[0]))
        best = min(best, (m * float(np.log(left)) + 2 * order, phi), key=lambda one: one[0])
    phi = best[1]
    p = phi.size
    found[: p + 1] = c[: p + 1]
    for lag in range(p + 1, m):
        found[lag] = phi @ found[lag - 1 : lag - p - 1 : -1] if p else 0.0
        if abs(found[lag]) < 1e-9 * c[0]:
            break
    return CorrelatedErrors(found)
