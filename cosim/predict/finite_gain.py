"""M^t as a gain: the largest response of a robot to a force on [0, t], per unit of its L2 norm.

    M^t = sup over f of ‖y‖₂ / ‖f‖₂ on [0, t],   y = G f from rest

The supremum is the largest singular value of the convolution with the impulse response of G(p) on
[0, t], taken in steps. The response comes from the inverse Laplace transform along Re p > 0; the
singular value from the power iteration f <- Gᵀ G f, in which Gᵀ is the same convolution backwards
in time. The iterates are lower bounds and increase. No run of a linear system from rest has a
greater ‖y‖₂/‖f‖₂; a constant push of a pure integral reaches π/√12 = 0.907 of the gain.

Source: the paper, Definition 1, for M^t; the numerical method is our own construction from the
power iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi

import numpy as np

from cosim.predict.facts import Array
from cosim.predict.interpolated import interpolated
from cosim.predict.network import DENSE, Complex, RobotNetwork

#: Samples of [0, t]; the error of the gain falls with their square.
SAMPLES = 1024
#: Iterations at the most, and the relative rise at which they end.
MOST, ENOUGH = 200, 1e-7


def response_by_steps(G: Callable[[Complex], Complex], t: float, n: int) -> Array:
    """Mean response in step k to a force of 1 held over step 0, k = 0 … n - 1, (n, m, m).

    In units of G. `G(p)`: (..., m, m) for p (...), 1/s; steps of h = t/n, t in s. Held and
    averaged, a force passes (2 sinh(ph/2)/(ph))² G; exp(-16) damps aliases of the transform.
    """
    h, period = t / n, 4 * n
    shift = 16.0 / (period * h)
    omega = 2 * pi * np.arange(period // 2 + 1) / (period * h)
    p: Complex = np.asarray(shift + 1j * omega, dtype=np.complex128)
    held = (2 * np.sinh(p * h / 2) / (p * h)) ** 2
    values = np.fft.irfft(held[:, None, None] * G(p), period, axis=0)[:n]
    return np.asarray(values * np.exp(shift * h * np.arange(n))[:, None, None])


def finite_gain(G: Callable[[Complex], Complex], t: float, n: int = SAMPLES) -> float:
    """Return the supremum of ‖G f‖₂/‖f‖₂ over forces f on [0, `t`] (s), from rest, in units of G.

    `G` maps p (n,) to G(p), (n,) or (n, m, m). Uses forces held over `n` steps and the mean
    response in each step. The result is a lower bound of the supremum over all forces; its error
    decreases with the square of the step.
    """
    spectrum = np.fft.rfft(response_by_steps(G, t, n), 2 * n, axis=0)
    backwards = np.swapaxes(spectrum, 1, 2)

    def convolved(S: Complex, x: Array) -> Array:
        product = np.einsum("kab,kb->ka", S, np.fft.rfft(x, 2 * n, axis=0))
        return np.asarray(np.fft.irfft(product, 2 * n, axis=0)[:n])

    m = spectrum.shape[1]
    cosine = np.cos(pi * (np.arange(n) + 0.5) / (2 * n))  # the worst force of a pure integral
    f = cosine[:, None] * (1.0 + 0.1 * np.arange(m))
    gain = 0.0
    for _ in range(MOST):
        f /= np.linalg.norm(f)
        y = convolved(spectrum, f)
        before, gain = gain, float(np.linalg.norm(y))
        if gain - before <= ENOUGH * gain:
            break
        f = convolved(backwards, y[::-1])[::-1]
    return gain


def network_gain(net: RobotNetwork, q: Array, t: float) -> float:
    """M^t from the torque at the port to the mean position of all robots of `net`, rad/(N.m).

    Over `t` s, linear about `q` (m,) rad, from rest with theta known; of the mean graph, and with
    exp(-p T) at its mean over the delays.
    """
    G = net.at(tuple(q), net.true_estimates()).mean_gain
    return finite_gain(G if len(net.laws) <= DENSE else partial(interpolated, G), t)
