"""Multisine excitation of a system with a known transfer function."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.predict.frequency import MultiSine, PortGain, degree

H = 0.01


@given(lowest=st.floats(0.05, 2.0), factor=st.floats(2.0, 200.0), count=st.integers(3, 40))
def test_frequencies_share_a_period_and_are_within_reach(
    lowest: float, factor: float, count: int
) -> None:
    sines = MultiSine.spread(lowest, lowest * factor, H, count, 1.0)
    omega = sines.omega
    assert omega[0] == pytest.approx(2 * pi / sines.period) == pytest.approx(lowest, rel=0.05)
    assert (np.diff(omega) > 0).all() and omega[-1] <= pi / 4 / H * (1 + 1e-9)
    assert len(omega) <= count


def test_values_have_the_amplitudes_and_no_mean() -> None:
    sines = MultiSine.spread(0.1, 20.0, H, 16, 0.5)
    wave = sines.values()
    assert len(wave) == sines.n and abs(wave.mean()) < 1e-12
    assert np.abs(sines.transform(wave[:, None])[:, 0]) == pytest.approx(0.5 * sines.n / 2)
    assert np.abs(wave).max() < 0.75 * 0.5 * len(sines.bins)  # not all at their peak at once


def first_order(a: float) -> tuple[PortGain, np.ndarray]:
    """y⁺ = y + h (f - a y): G = h/(z - 1 + a h), as fed with many sines; and G itself."""
    sines = MultiSine.spread(0.05, 20.0, H, 20, 1.0)
    f = np.tile(sines.values(), 3)
    y = np.zeros(len(f) + 1)
    for k, value in enumerate(f):
        y[k + 1] = y[k] + H * (value - a * y[k])
    G = sines.transform(y[:-1, None]) / sines.transform(f[:, None])
    z = np.exp(1j * sines.omega * H)
    return PortGain(sines.omega, G[:, :, None], H), H / (z - 1 + a * H)


def test_a_transfer_function_is_found_exactly() -> None:
    gain, exact = first_order(0.8)
    assert gain.G[:, 0, 0] == pytest.approx(exact, rel=1e-6)


def test_degree_of_an_integrator_and_of_a_lag() -> None:
    assert degree(first_order(0.0)[0]) == (pytest.approx(1.0, abs=1e-3), True)
    k, whole = degree(first_order(0.08)[0])
    assert not whole and 0 < k < 1


def gains(inertia: float, damping: float, stiffness: float, h: float = 1e-9) -> PortGain:
    w = np.geomspace(0.05, 50.0, 60)
    Z = 1j * w * inertia + damping + stiffness / (1j * w)
    return PortGain(w, (1 / (1j * w * Z))[:, None, None], h)


@given(I=st.floats(0.1, 10), D=st.floats(0.1, 20), S=st.floats(0.0, 50))
def test_impedance_is_fitted_in_bands(I: float, D: float, S: float) -> None:  # noqa: E741
    found = gains(I, D, S).fitted_impedance(0.1, 10.0)
    assert [x[0] for x in found] == pytest.approx([I, D, S], rel=1e-3, abs=1e-3)


def test_real_part_says_what_is_passive() -> None:
    assert gains(1.0, 2.0, 3.0).least()[0] > 0
    real, _, share = gains(1.0, -0.5, 0.0).least()
    assert real < 0 and share < 0


def test_a_band_without_frequencies_has_no_impedance() -> None:
    assert all(np.isnan(x).all() for x in gains(1.0, 1.0, 1.0).fitted_impedance(60.0, 70.0))


def test_admittance_is_the_mean_velocity_of_a_step() -> None:
    """A free mass m under a held force: Δq/h over f is h/m (1/(z - 1) + 1/2)."""
    h, m, w = 0.02, 3.0, np.array([0.5, 10.0, 40.0])
    z = np.exp(1j * w * h)
    G = h * h / (2 * m) * (z + 1) / (z - 1) ** 2  # position of a mass, force held
    Y = PortGain(w, G[:, None, None], h).admittance[:, 0, 0]
    assert pytest.approx(h / m * (1 / (z - 1) + 0.5)) == Y
    assert Y.real == pytest.approx(0.0, abs=1e-12)  # a mass is passive, sampled or not
