"""Natural adaptation: its function of Lyapunov, and estimates that remain bodies."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.arms.chain import unphysical
from fmus.arms.natural import adapted, parameters, pseudo_inertia
from tests.fmus.chains import random_body


def divergence(estimate: np.ndarray, true: np.ndarray) -> float:
    P_hat, P = pseudo_inertia(estimate), pseudo_inertia(true)
    ratio = np.linalg.det(P_hat) / np.linalg.det(P)
    return float(np.log(ratio) + np.trace(np.linalg.solve(P_hat, P)) - 4.0)


def test_the_pseudo_inertia_has_the_parameters_of_the_body() -> None:
    theta = random_body(np.random.default_rng(1))
    assert np.linalg.eigvalsh(pseudo_inertia(theta))[0] > 0.0
    assert np.allclose(parameters(pseudo_inertia(theta)), theta, rtol=1e-14)


def test_the_divergence_changes_as_the_proof_needs() -> None:
    """dV/dt = -rate ell' (theta_hat - theta), so that V / rate cancels s' Y (theta_hat - theta)."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        true, estimate, ell = random_body(rng), random_body(rng), rng.normal(size=10)
        assert divergence(true, true) == pytest.approx(0.0, abs=1e-12)
        step = 1e-7
        change = divergence(adapted(estimate, ell, step), true) - divergence(estimate, true)
        assert change / step == pytest.approx(-ell @ (estimate - true), rel=1e-4, abs=1e-4)


def test_the_estimate_remains_a_body_for_any_gradient_and_rate() -> None:
    rng = np.random.default_rng(3)
    theta = random_body(rng)
    for _ in range(30):
        before = pseudo_inertia(theta)
        theta = adapted(theta, 100.0 * rng.normal(size=10), 10.0)
        taken = np.linalg.eigvals(np.linalg.solve(before, pseudo_inertia(theta))).real
        assert 0.5 - 1e-6 <= taken.min() <= taken.max() <= 1.5 + 1e-6
        assert unphysical(theta) is None
