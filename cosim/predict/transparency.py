"""Transparency, Z-width and free impedance: what a port shows over a band of frequencies.

With Z(jω) the impedance at the operator's port, (m, m), σ_i its singular values, Z_e that of the
environment at the far robot, and averages over ln ω from ω_1 to ω_2 (trapezoids, weights w_k)::

    transparency    ε = sqrt( 1/ln(ω_2/ω_1) ∫ mean_i (20 log10 σ_i(Z_to)/|Z_e|)² dlnω )      dB
    Z-width         W = 1/ln(ω_2/ω_1) ∫ 20 log10 (|det Z_max|/|det Z_min|)^(1/m) dlnω        dB
    free impedance  Z_f = exp( 1/ln(ω_2/ω_1) ∫ ln |det Z_min|^(1/m) dlnω )             N.m.s/rad

Z_to is with the environment in place, Z_min in free motion, Z_max against a rigid environment. ε is
0 where the hand feels just the environment. For m = 1 these are the usual scalar forms.

Sources: Z_to = Z_e as the aim: Lawrence, IEEE T-RA 9(5), 1993; the range of impedances: Colgate and
Brown, ICRA 1994; the averages over ln ω and singular values are a choice of this project.
"""

from __future__ import annotations

from math import log10, sqrt

import numpy as np

from cosim.predict.facts import Array
from cosim.predict.frequency import PortGain

#: dB of a relative change of 1, for small changes.
_DB = 20 / np.log(10)

#: A number and two standard deviations of it.
Estimate = tuple[float, float]


def log_weights(omega: Array) -> Array:
    """Weights of an average over ln ω by trapezoids, (k,); they sum to 1. `omega` (k,), rad/s."""
    steps = np.diff(np.log(omega))
    weights = np.zeros(len(omega))
    weights[:-1] += steps / 2
    weights[1:] += steps / 2
    return np.asarray(weights / weights.sum())


def spring_impedance(omega: Array, stiffness: float, damping: float) -> Array:
    """|Z_e| = |k/(jω) + b| (k,), N.m.s/rad; `stiffness` N.m/rad, `damping` N.m.s/rad."""
    return np.asarray(np.hypot(stiffness / omega, damping))


def transparency_error(gain: PortGain, environment: Array) -> Estimate:
    """ε, dB, with its uncertainty; `environment`: |Z_e| (k,) N.m.s/rad at the frequencies."""
    w = log_weights(gain.omega)
    sigma = np.linalg.svd(gain.impedance, compute_uv=False)  # (k, m)
    x = 20 * np.log10(sigma / environment[:, None])
    error = sqrt(float(w @ (x**2).mean(axis=1)))
    size = np.sqrt((x**2).mean(axis=1))  # of x, (k,), dB
    spread = float(np.sqrt(((w * size * _DB * gain.error) ** 2).sum()))
    return error, spread / error if error > 0 else 0.0


def z_width(free: PortGain, rigid: PortGain) -> Estimate:
    """W, dB, with its uncertainty; both gains at the same frequencies."""
    w = log_weights(free.omega)
    ratio = _mean_log10(rigid) - _mean_log10(free)
    spread = np.sqrt(((w * _DB) ** 2 * (free.error**2 + rigid.error**2)).sum())
    return 20 * float(w @ ratio), float(spread)


def free_impedance(free: PortGain) -> Estimate:
    """Z_f, N.m.s/rad, with its uncertainty."""
    w = log_weights(free.omega)
    value = 10 ** float(w @ _mean_log10(free))
    return value, value * float(np.sqrt(((w * free.error) ** 2).sum()))


def passivity_margin(gain: PortGain) -> Estimate:
    """The least Re Y/|Y|, dimensionless, with its uncertainty; not below 0 if passive."""
    share = gain.shares()
    at = int(np.argmin(share))
    return float(share[at]), float(gain.error[at])


def _mean_log10(gain: PortGain) -> Array:
    """log10 |det Z|^(1/m), (k,)."""
    m = gain.G.shape[1]
    _, log_det = np.linalg.slogdet(gain.impedance)
    return np.asarray(log_det * log10(np.e) / m)
