"""Frequency response of the port, measured with a multisine force.

The force is a sum of cosines whose periods all divide one period T_0, added to the present force,
so that the transform of the last T_0 separates them exactly. The integral of a cosine has no mean,
so no integrator of the robot drifts. The transform is applied to the difference of two runs, with
and without the force, that are equal in everything else: motion without the force cancels.

G(jω) is response over force. With the force held over a step h and the velocity taken as the mean
over that step, Y = (exp(jωh) - 1)/h G exactly represents the power f · v: the port is passive under
such forces iff Y + Yᴴ is never negative.

Source: own construction (multisine excitation, discrete Fourier transform; positive-real condition
of passivity).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, nan, pi

import numpy as np
from numpy.typing import NDArray

from cosim.predict.facts import Array

Complex = NDArray[np.complex128]

#: Bins not fed in from which the noise at a bin that is fed in is estimated.
NEAR = 6
#: Share of |Y| below which Re Y is 0: rounding, and what is left of a decay.
LOSSLESS = 1e-6


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

    def deviation(self, periods: Array) -> Array:
        """Standard deviation of the transform of the mean of `periods` (p, n, m), (bins, m).

        Of several periods, from how they scatter, relative to the mean and averaged with the bins
        on both sides. Of one period, from the nearest bins that were not fed in, over which what
        jumps and switches spreads as well.
        """
        X = np.fft.rfft(periods, axis=1)
        if len(X) == 1:
            power = np.abs(X[0]) ** 2
            free = np.setdiff1d(np.arange(1, len(power)), self.bins)
            near = [free[np.argsort(np.abs(free - b), kind="stable")[:NEAR]] for b in self.bins]
            return np.asarray(np.sqrt([power[around].mean(axis=0) for around in near]))
        X = X[:, list(self.bins)]
        mean = X.mean(axis=0)
        variance = (np.abs(X - mean) ** 2).sum(axis=0) / (len(X) - 1) / len(X)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.pad(variance / np.abs(mean) ** 2, ((1, 1), (0, 0)), mode="edge")
        return np.asarray(np.sqrt((share[:-2] + share[1:-1] + share[2:]) / 3) * np.abs(mean))

    def off_frequency_share(self, x: Array) -> float:
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

    `off_frequency_share`: the greatest share of the response's power at other frequencies; `sd`:
    the resulting standard deviation of G, (k, m, m), None: exact.
    """

    omega: Array
    G: Complex
    h: float
    off_frequency_share: float = 0.0
    sd: Array | None = None

    @property
    def error(self) -> Array:
        """Two standard deviations of |G|, or of a part of Y, as a share of |G| or |Y|, (k,)."""
        if self.sd is None:
            return np.zeros(len(self.omega))
        whole = np.linalg.norm(self.sd, axis=(1, 2)) / np.sqrt(2.0)
        return np.asarray(2.0 * whole / self.size)

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

    def shares(self) -> Array:
        """Least Re Y/|Y| at each frequency, (k,): how active the port is there."""
        return np.asarray(self.real_part() / np.linalg.norm(self.admittance, 2, axis=(1, 2)))

    def least(self) -> tuple[float, float, float]:
        """(min Re Y, at ω, as a share of |Y| there): the share tells how active it is."""
        share = self.shares()
        at = int(np.argmin(share))
        return float(self.real_part()[at]), float(self.omega[at]), float(share[at])

    def passive(self) -> bool | None:
        """True if Re Y is nowhere below 0; None where the uncertainty leaves it open.

        A share of |Y| within `LOSSLESS` of 0 counts as 0. As many frequencies are looked at, a
        verdict takes twice the uncertainty of one of them.
        """
        share, error = self.shares(), 2.0 * self.error
        if (share + error < -LOSSLESS).any():
            return False
        return True if (share - error >= -LOSSLESS).all() else None

    def slope(self) -> float:
        """Slope d log |G|/d log ω at the lowest frequencies."""
        if len(self.omega) < 2:
            return nan
        size = self.size
        return log(size[1] / size[0]) / log(self.omega[1] / self.omega[0])

    def slope_error(self) -> float:
        """Two standard deviations of :meth:`slope`; NaN with fewer than two frequencies."""
        if len(self.omega) < 2:
            return nan
        return float(np.hypot(*self.error[:2])) / log(self.omega[1] / self.omega[0])

    def felt_error(self, low: float, high: float) -> Array:
        """Two standard deviations of the felt inertia I, damping D and stiffness S, (3, m).

        Z of a joint has the relative uncertainty of G; D is its weighted mean, I and S are least
        squares, so all shrink with the number of frequencies in the band.
        """
        m = self.G.shape[1]
        band = (self.omega >= low * (1 - 1e-9)) & (self.omega <= high * (1 + 1e-9))
        if band.sum() < 2:
            return np.full((3, m), nan)
        w, e = self.omega[band], self.error[band]
        Z = np.abs(np.diagonal(self.impedance[band], axis1=1, axis2=2))
        D = np.sqrt((e**2).sum()) / (1 / Z).sum(axis=0)
        found = np.empty((3, m))
        for j in range(m):
            X = np.column_stack([w, -1 / w]) / Z[:, [j]]
            found[0, j], found[2, j] = np.sqrt(((np.linalg.pinv(X) * e) ** 2).sum(axis=1))
        found[1] = D
        return found

    def fitted_impedance(self, low: float, high: float) -> tuple[Array, Array, Array]:
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

    `k` and `tolerance` are dimensionless. Not whole: the lowest frequency is not low enough, or the
    system is not one of rational gain.
    """
    slope = -gain.slope()
    return slope, abs(slope - round(slope)) <= tolerance
