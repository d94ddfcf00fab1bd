"""M^t as a supremum, against closed cases and against a dense singular value decomposition."""

from __future__ import annotations

from collections.abc import Callable
from math import pi

import numpy as np
import pytest

from cosim.analysis.analysis import analyse
from cosim.predict.closed_form import manipulability_bound
from cosim.predict.finite_gain import finite_gain, network_gain, response_by_steps
from cosim.predict.interpolated import interpolated
from cosim.predict.network import Complex
from fmus.paper import oracles
from fmus.paper.experiments import network, single
from tests.analysis.cases import DOCUMENTS, net_of, number, subject
from tests.paper.oracles import push_manipulability


def integral(p: Complex) -> Complex:
    return np.asarray(1.0 / p[..., None, None])


def quasi_static(p: Complex) -> Complex:
    """One arm of Sec. VII-A without inertia: (p + 6)/(16 p (p + 2))."""
    return np.asarray(((p + 6) / (16 * p * (p + 2)))[..., None, None])


def test_gain_of_an_integral_is_that_of_the_volterra_operator() -> None:
    """2 t/π, with the worst force cos(πτ/2t)."""
    for t in (0.5, 80.0):
        assert finite_gain(integral, t) == pytest.approx(2 * t / pi, rel=1e-4)


def test_gain_of_the_single_arm_lies_between_its_push_and_its_bound() -> None:
    """At 80 s: 8.608 of a push, 9.510 the supremum by another method (to 0.02 %), 9.581 of O6."""
    gain = finite_gain(quasi_static, 80.0)
    assert gain == pytest.approx(9.510, rel=2e-4)
    assert push_manipulability(80.0, 16.0, 2.0, 6.0) == pytest.approx(8.608, rel=1e-3)
    assert float(oracles.manipulability_bound(80.0, 16.0, 2.0, 6.0)) == pytest.approx(9.581, 1e-3)


def test_gain_is_the_largest_singular_value_of_the_matrix_of_steps() -> None:
    def coupled(p: Complex) -> Complex:
        own = quasi_static(p)[..., 0, 0]
        G = np.empty((*p.shape, 2, 2), complex)
        G[..., 0, 0], G[..., 1, 1] = own, 1 / (p + 1)
        G[..., 0, 1], G[..., 1, 0] = 0.3 * own, 0.1 / (p + 1) * np.exp(-0.5 * p)
        return G

    n = 120
    g = response_by_steps(coupled, 6.0, n)
    dense = np.zeros((n, 2, n, 2))
    for k in range(n):
        for j in range(k + 1):
            dense[k, :, j, :] = g[k - j]
    expected = np.linalg.svd(dense.reshape(2 * n, 2 * n), compute_uv=False)[0]
    assert finite_gain(coupled, 6.0, n) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("name", ["single-6", "single-0", "pair-10", "pair-1"])
def test_gain_of_known_robots_stays_below_o6(name: str) -> None:
    net = net_of(DOCUMENTS[name])
    limit = manipulability_bound(net, np.array([40.0]), 16.0)[0]
    assert 0.2 * limit < network_gain(net, np.array([0.3, 0.2]), 40.0) < limit * 1.001


def test_gain_of_a_network_is_that_of_its_mean_robot() -> None:
    """2 λ_M/(παK n)·t for n robots in a balanced graph without delay: they share the push."""
    net = net_of(network(5.0))
    rise = network_gain(net, np.array([0.3, 0.2]), 400.0) - network_gain(net, np.zeros(2), 200.0)
    assert rise == pytest.approx(2 * 10.0 * 200.0 / (pi * 1.6 * 16.0 * 6), rel=0.02)


def test_both_numbers_are_printed_and_named_differently() -> None:
    known = {"theta_hat": [3.34, 1.2, 0.97], "Gamma": 0.0}
    found = analyse(subject(single(10.0, **known)), tests=False)
    run, gain = number(found, "manipulability"), number(found, "gain")
    assert (run.label, gain.label) == ("M^t of this run", "M^t, gain")
    assert run.values[0] < gain.values[0] < gain.expected[0] == run.expected[0]


def test_m_t_of_a_pair_is_that_of_the_mean_of_its_arms() -> None:
    """The definition that `cosim reproduce` has, Sec. V: q_c = (q_1 + q_2)/2."""
    found = analyse(subject(DOCUMENTS["pair-10"]), tests=False)
    assert found.port.members == ("master.q", "slave.q")
    assert found.recorded.mean
    (r,) = found.recorded
    y = r.moved - r.moved[0]
    ratio = np.sqrt(np.trapezoid((y**2).sum(1), r.t) / np.trapezoid((r.force**2).sum(1), r.t))
    assert number(found, "manipulability").values == pytest.approx([ratio], rel=1e-9)
    assert not np.allclose(r.moved, r.response)


@pytest.mark.parametrize(
    ("G", "most"),
    [
        (quasi_static, 140),  # slow and fast poles
        (lambda p: quasi_static(p) * np.exp(-0.3 * p)[..., None, None], 270),
        (lambda p: quasi_static(p) / (p * p + p + 4.0)[..., None, None], 540),  # swings
        (lambda p: np.exp(-50.0 * p)[..., None, None], 3000),  # cannot be had from few
    ],
)
def test_a_response_at_many_points_follows_from_few(
    G: Callable[[Complex], Complex], most: int
) -> None:
    asked = 0

    def counted(p: Complex) -> Complex:
        nonlocal asked
        asked += len(p)
        return G(p)

    p = 0.033 + 1j * np.linspace(0.0, 26.8, 2049)
    assert np.abs(interpolated(counted, p) - G(p)).max() < 1e-7 * np.abs(G(p)).max()
    assert asked <= most
