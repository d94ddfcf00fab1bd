"""Transparency, Z-width and their uncertainties, against impedances that are known."""

from __future__ import annotations

from math import log, log10, sqrt

import numpy as np
import pytest

from cosim.predict.frequency import PortGain
from cosim.predict.transparency import (
    free_impedance,
    log_weights,
    passivity_margin,
    spring_impedance,
    transparency_error,
    z_width,
)

OMEGA = np.geomspace(0.6, 30.0, 400)
H = 1e-9  # so fine that a step does not show


def gain(Z: np.ndarray, sd: float = 0.0) -> PortGain:
    """The port whose impedance is Z (k, m, m); `sd`: of each entry of G, as a share of |G|."""
    factor = (np.exp(1j * OMEGA * H) - 1) / H
    G = np.linalg.inv(Z) / factor[:, None, None]
    each = np.abs(G).max(axis=(1, 2))[:, None, None] * np.eye(Z.shape[1])
    return PortGain(OMEGA, G, H, 0.0, sd * each)


def diagonal(*z: np.ndarray) -> np.ndarray:
    return np.stack([np.diag(row) for row in np.stack(z, axis=1)])


def test_weights_are_an_average_over_the_logarithm() -> None:
    w = log_weights(OMEGA)
    assert w.sum() == pytest.approx(1.0)
    assert w @ np.log(OMEGA) == pytest.approx(0.5 * (log(0.6) + log(30.0)))


def test_the_error_is_zero_where_the_hand_feels_the_environment() -> None:
    Z_e = 100.0 / (1j * OMEGA) + 2.0
    error, spread = transparency_error(gain(diagonal(Z_e, Z_e)), spring_impedance(OMEGA, 100, 2))
    assert error == pytest.approx(0.0, abs=1e-5) and spread == pytest.approx(0.0, abs=1e-9)


def test_a_constant_factor_is_its_decibels_and_joints_are_averaged() -> None:
    Z_e = 100.0 / (1j * OMEGA) + 2.0
    environment = spring_impedance(OMEGA, 100.0, 2.0)
    error, _ = transparency_error(gain(diagonal(0.1 * Z_e, 0.1 * Z_e)), environment)
    assert error == pytest.approx(20.0)
    error, _ = transparency_error(gain(diagonal(0.1 * Z_e, Z_e)), environment)
    assert error == pytest.approx(20.0 / sqrt(2))


def test_a_mass_in_front_of_a_spring_has_its_integral() -> None:
    """Z_to/Z_e = 1 - ω²m/k, b = 0: numerically integrated on another grid."""
    m, k = 0.05, 100.0
    error, _ = transparency_error(
        gain(diagonal(1j * OMEGA * m + k / (1j * OMEGA))), spring_impedance(OMEGA, k, 0.0)
    )
    x = np.log(np.linspace(0.6, 30.0, 400_000))
    y = (20 * np.log10(np.abs(1 - np.exp(2 * x) * m / k))) ** 2
    expected = sqrt(np.trapezoid(y, x) / (x[-1] - x[0]))
    assert error == pytest.approx(expected, rel=1e-3)


def test_z_width_of_a_mass_and_a_spring() -> None:
    """|Z_max/Z_min| = k/(m ω²): the average of its decibels is that at the middle of ln ω."""
    m, k = np.array([2.0, 0.5]), 1000.0
    free = gain(diagonal(*(1j * OMEGA * x for x in m)))
    rigid = gain(diagonal(*(k / (1j * OMEGA) for _ in m)))
    width, _ = z_width(free, rigid)
    assert width == pytest.approx(20 * log10(k / (sqrt(2.0 * 0.5) * 0.6 * 30.0)))
    felt, _ = free_impedance(free)
    assert felt == pytest.approx(sqrt(2.0 * 0.5) * sqrt(0.6 * 30.0))


def test_the_margin_is_the_least_share_of_the_real_part() -> None:
    """Y = 1/(b + jωm) has Re Y/|Y| = b/sqrt(b² + ω²m²): least at the highest frequency."""
    margin, _ = passivity_margin(gain(diagonal(2.0 + 1j * OMEGA * 0.5)))
    assert margin == pytest.approx(2.0 / sqrt(4.0 + (30.0 * 0.5) ** 2), rel=1e-5)


@pytest.mark.parametrize("sd", [0.001, 0.01])
def test_uncertainties_are_those_of_noisy_repetitions(sd: float) -> None:
    """Two standard deviations of 300 draws of G with noise of that size, to a quarter."""
    rng = np.random.default_rng(1)
    Z_e = 100.0 / (1j * OMEGA) + 2.0
    exact, environment = gain(diagonal(0.1 * Z_e), sd), spring_impedance(OMEGA, 100.0, 2.0)
    rigid = gain(diagonal(30.0 * Z_e), sd)
    found: list[tuple[float, float]] = []
    for _ in range(300):
        noisy = []
        for each in (exact, rigid):
            shape = each.G.shape
            noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
            noise *= sd * np.abs(each.G) / sqrt(2)
            noisy.append(PortGain(OMEGA, each.G + noise, H))
        found.append((transparency_error(noisy[0], environment)[0], z_width(*noisy)[0]))
    spread = 2 * np.std(found, axis=0)
    assert transparency_error(exact, environment)[1] == pytest.approx(spread[0], rel=0.25)
    assert z_width(exact, rigid)[1] == pytest.approx(spread[1], rel=0.25)
