"""The port by frequency: a force of many sines, and what the response says about it.

The force is a sum of cosines whose periods all divide one period T_0, fed in on top of what is, so
that the transform of the last T_0 separates them exactly. Cosines: their integral has no mean, and
so no integrator of the robot drifts away. What is transformed is the difference of two runs, with
and without the force, which are alike in everything else: what moves by itself cancels.

G(jω) is response over force. With the force held over a step h and the velocity taken as the mean
over that step, Y = (exp(jωh) - 1)/h G is exactly what has the power f · v: the port is passive
towards such forces iff Y + Yᴴ is never negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, nan, pi

import numpy as np
from numpy.typing import NDArray

from cosim.analysis.facts import Array

Complex = NDArray[np.complex128]


@dataclass(frozen=True, slots=True)
class MultiSine:
    """cosines at `bins` times 1/T_0, T_0 = n h: `h` s a value, `n` values a period."""

    h: float
    n: int
    bins: tuple[int, ...]
    amplitude: float

    @staticmethod
    def spread(lowest: float, highest: float, h: float, count: int, amplitude: float) -> MultiSine:
        """About `count` frequencies spread evenly over log ω from `lowest` to `highest`, rad/s.

        The highest is at most a quarter of what the step `h` (s) can show.
        """
        n = max(16, round(2 * pi / lowest / h))
        last = max(2, min(n // 8, round(highest * n * h / (2 * pi))))
        bins = np.unique(np.geomspace(1, last, count).round().astype(int))
        return MultiSine(h, n, tuple(bins.tolist()), amplitude)

    @property
    def omega(self) -> Array:
        """Frequencies of the sines, (bins,), rad/s."""
        return 2 * pi * np.array(self.bins) / (self.n * self.h)

    @property
    def period(self) -> float:
        """T_0, s."""
        return self.n * self.h

    def values(self) -> Array:
        """One period, (n,); signs change in a pattern that keeps the peak low."""
        spectrum = np.zeros(self.n // 2 + 1, dtype=np.complex128)
        for i, b in enumerate(self.bins):
            spectrum[b] = (-1.0) ** (i * (i - 1) // 2) * self.amplitude * self.n / 2
        return np.fft.irfft(spectrum, self.n)

    def transform(self, x: Array) -> Complex:
        """Amplitudes of the last period of `x` (k, m) at the frequencies, (bins, m)."""
        return np.asarray(np.fft.rfft(x[-self.n :], axis=0)[list(self.bins)])

    def astray(self, x: Array) -> float:
        """Share of the power of the last period of `x` (k, m) that is at other frequencies.

        Of what is linear, constant in time and stable nothing is, once it has settled.
        """
        power = (np.abs(np.fft.rfft(x[-self.n :], axis=0)) ** 2).sum(axis=1)
        power[0] = 0.0  # a drift
        total = float(power.sum())
        return 1 - float(power[list(self.bins)].sum()) / total if total > 0 else 0.0


@dataclass(frozen=True, slots=True)
class PortGain:
    """G(jω), (k, m, m), response over force, at `omega` (k,) rad/s, forces held over `h` s.

    `astray`: the greatest share of the response's power that was at other frequencies.
    """

    omega: Array
    G: Complex
    h: float
    astray: float = 0.0

    @property
    def admittance(self) -> Complex:
        """Y(jω), (k, m, m): mean velocity of a step over force."""
        factor = (np.exp(1j * self.omega * self.h) - 1) / self.h
        return np.asarray(factor[:, None, None] * self.G)

    @property
    def impedance(self) -> Complex:
        """Z(jω) = Y⁻¹, (k, m, m)."""
        return np.asarray(np.linalg.inv(self.admittance))

    @property
    def size(self) -> Array:
        """The largest gain at each frequency, (k,): largest singular value of G."""
        return np.asarray(np.linalg.svd(self.G, compute_uv=False)[:, 0])

    def real_part(self) -> Array:
        """Least eigenvalue of (Y + Yᴴ)/2 at each frequency, (k,); not negative if passive."""
        Y = self.admittance
        return np.asarray(np.linalg.eigvalsh((Y + np.conj(np.swapaxes(Y, 1, 2))) / 2)[:, 0])

    def least(self) -> tuple[float, float, float]:
        """(min Re Y, at ω, as a share of |Y| there): the share tells how active it is."""
        real, length = self.real_part(), np.linalg.norm(self.admittance, 2, axis=(1, 2))
        at = int(np.argmin(real / length))
        return float(real[at]), float(self.omega[at]), float(real[at] / length[at])

    def slope(self) -> float:
        """Slope d log |G|/d log ω at the lowest frequencies."""
        if len(self.omega) < 2:
            return nan
        size = self.size
        return log(size[1] / size[0]) / log(self.omega[1] / self.omega[0])

    def felt(self, low: float, high: float) -> tuple[Array, Array, Array]:
        """(I, D, S), (m,) each: Z = jω I + D + S/(jω) fitted from `low` to `high`, rad/s.

        Of each joint alone; NaN with fewer than two frequencies in the band. Each frequency weighs
        by 1/|Z|.
        """
        m = self.G.shape[1]
        band = (self.omega >= low * (1 - 1e-9)) & (self.omega <= high * (1 + 1e-9))
        if band.sum() < 2:
            return np.full(m, nan), np.full(m, nan), np.full(m, nan)
        w, Z = self.omega[band], np.diagonal(self.impedance[band], axis1=1, axis2=2)  # (k, m)
        weight = 1 / np.abs(Z)
        D = (Z.real * weight).sum(axis=0) / weight.sum(axis=0)
        IS = [
            np.linalg.lstsq(np.column_stack([w, -1 / w]) * weight[:, [j]],
                            Z.imag[:, j] * weight[:, j], rcond=None)[0]
            for j in range(m)
        ]  # fmt: skip
        return np.array([x[0] for x in IS]), D, np.array([x[1] for x in IS])


def degree(gain: PortGain, tolerance: float = 0.1) -> tuple[float, bool]:
    """(k, whether it is whole): number of pure integrals from force to response, -slope of |G|.

    Not whole: the lowest frequency is not low enough, or the system is not one of rational gain.
    """
    slope = -gain.slope()
    return slope, abs(slope - round(slope)) <= tolerance
