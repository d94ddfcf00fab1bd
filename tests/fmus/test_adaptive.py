"""Options of the adaptive law: what each adds to eqs (29)-(32) and (42)-(45), in NumPy and in C."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.arms.adaptive_variables import ADAPTED, COMPENSATED, NONE
from fmus.arms.dynamics import coriolis, gravity, gravity_regressor, inertia, regressor
from fmus.models import adaptive, teleoperation
from fmus.models.teleoperation import Teleoperation
from tests.fmus.loops import Values, arrays

Make = Callable[..., Component]
H = 5e-3  # s

seed = st.integers(0, 2**32 - 1)


@pytest.fixture(
    scope="module",
    params=[pytest.param(Teleoperation, marks=pytest.mark.slow), teleoperation.kernel],
    ids=["numpy", "c"],
    name="make",
)
def make_(request: pytest.FixtureRequest) -> Make:
    make: Make = request.param
    return make


def moving(rng: np.random.Generator) -> Values:
    """The arm's state at random."""
    return {"q": rng.uniform(-3, 3, 2), "dq": rng.uniform(-2, 2, 2)}


def received(rng: np.random.Generator, n: int) -> Values:
    """What n neighbours sent, at random."""
    return {"xi_in": rng.uniform(-3, 3, (n, 2)), "w": rng.uniform(0.1, 1, n), "age": np.zeros(n)}


def estimate(rng: np.random.Generator, p: int = 3) -> Values:
    return {"z": rng.uniform(-2, 2, 2), "theta_hat": rng.uniform(0.5, 4, p)}


def two_steps(law: Component, gains: Values, u: Values) -> tuple[Values, Values]:
    """Outputs of two steps with the same inputs: the law, and what it made of z and theta_hat."""
    law.initialize(gains)
    first, second = (
        {name: np.array(value) for name, value in law.step(k * H, H, u).items()} for k in range(2)
    )
    return first, second


# --- one arm alone ---------------------------------------------------------------------------


@given(seed=seed)
def test_one_arm_alone_is_an_arm_whose_neighbour_has_no_weight(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gains, u = estimate(rng), moving(rng)
    alone = two_steps(make(0), gains, u)
    other = two_steps(make(1), gains, {**u, "xi_in": rng.uniform(-3, 3, (1, 2)), "w": np.zeros(1)})
    for a, b in zip(alone, other, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


def test_the_model_adaptive_is_the_law_without_neighbours() -> None:
    for gravity_ in (False, True):
        assert adaptive.model(gravity_) == teleoperation.model(0, gravity_)
        assert adaptive.Adaptive(gravity_).inputs == teleoperation.model(0, gravity_).inputs()
    assert [port.name for port in adaptive.model().inputs()] == ["q", "dq"]
    assert adaptive.model().identifier == "adaptive"


def test_alpha_may_be_zero_for_one_arm_alone_only(make: Make) -> None:
    make(0).initialize(arrays(alpha=0.0))
    with pytest.raises(CosimError, match="alpha"):
        make(1).initialize(arrays(alpha=0.0))


# --- Remark 3 --------------------------------------------------------------------------------


@given(seed=seed)
def test_remark_3_is_feedback_of_the_estimated_inertia(make: Make, seed: int) -> None:
    """tau = -lambda_c M_hat s + Y(q, dq, z, dz) theta_hat, adapted by Y(q, dq, z, dz - lambda_c s);
    K has no say."""
    rng = np.random.default_rng(seed)
    gains, u, lambda_c = estimate(rng), moving(rng), rng.uniform(0.1, 10)
    z, theta_hat = gains["z"], gains["theta_hat"]
    K = rng.uniform(0, 20, 2)
    first, second = two_steps(make(0), {**gains, **arrays(lambda_c=lambda_c, K=K)}, u)
    dz, s = -0.5 * u["dq"] + 10 * (u["dq"] - z), u["dq"] - z
    M_hat, C_hat = inertia(theta_hat, u["q"]), coriolis(theta_hat, u["q"], u["dq"])
    tau = -lambda_c * M_hat @ s + M_hat @ dz + C_hat @ z
    Y = regressor(u["q"], u["dq"], z, dz - lambda_c * s)
    assert np.allclose(first["tau"], tau, rtol=1e-11, atol=1e-10)
    assert np.allclose(second["z"], z + H * dz, rtol=1e-12, atol=1e-12)
    assert np.allclose(second["theta_hat"], theta_hat - H * Y.T @ s, rtol=1e-11, atol=1e-11)


# --- bounds of the estimate ------------------------------------------------------------------


@settings(max_examples=20)
@given(seed=seed)
def test_the_estimate_keeps_its_bounds_and_is_free_between_them(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = rng.uniform(0, 1, 3), rng.uniform(1, 2, 3)
    law, start = make(0), arrays(theta_hat=np.ones(3), Gamma=5.0 * np.ones(3))
    law.initialize({**start, **arrays(theta_min=low, theta_max=high)})
    before, was = np.ones(3), None
    for k in range(20):
        u = moving(rng)
        y = {name: np.array(value) for name, value in law.step(k * H, H, u).items()}
        assert (low <= y["theta_hat"]).all()
        assert (y["theta_hat"] <= high).all()
        if was is not None:
            dz = -0.5 * was["dq"] + 10 * was["s"]
            Y = regressor(was["q"], was["dq"], was["z"], dz)
            expected = np.clip(before - H * 5 * Y.T @ was["s"], low, high)
            assert np.allclose(y["theta_hat"], expected, rtol=1e-12, atol=1e-12)
        before, was = y["theta_hat"], {**u, **y}


def test_an_estimate_that_starts_outside_of_its_bounds_is_refused(make: Make) -> None:
    for bounds in (arrays(theta_min=np.ones(3)), arrays(theta_max=-np.ones(3))):
        with pytest.raises(CosimError, match="theta_hat starts"):
            make(1).initialize(bounds)


# --- stale neighbours ------------------------------------------------------------------------


@given(seed=seed, stale=st.lists(st.booleans(), min_size=2, max_size=2))
def test_a_stale_edge_does_not_count_and_stops_the_adaptation(
    make: Make, seed: int, stale: list[bool]
) -> None:
    rng = np.random.default_rng(seed)
    gains, u = estimate(rng), {**moving(rng), **received(rng, 2)}
    age = np.where(stale, 0.51, 0.5)
    first, second = two_steps(make(2), {**gains, **arrays(age_max=0.5)}, {**u, "age": age})
    cut = {**u, "w": np.where(stale, 0.0, u["w"])}
    frozen = {} if not any(stale) else arrays(Gamma=np.zeros(3))
    expected = two_steps(make(2), {**gains, **frozen}, cut)
    for a, b in zip((first, second), expected, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)
    assert not np.array_equal(first["z"], second["z"])


def test_an_edge_without_weight_may_be_as_old_as_it_likes(make: Make) -> None:
    rng = np.random.default_rng(8)
    gains, u = {**estimate(rng), **arrays(age_max=0.5)}, {**moving(rng), **received(rng, 2)}
    u["w"][1] = 0.0
    old = two_steps(make(2), gains, {**u, "age": np.array([0.1, 99.0])})
    new = two_steps(make(2), gains, u)
    for a, b in zip(old, new, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)
    assert not np.array_equal(old[0]["theta_hat"], old[1]["theta_hat"])


@given(seed=seed, part=st.floats(1e-3, 1.5))
def test_the_weight_of_a_stale_edge_falls_linearly_and_nothing_adapts_meanwhile(
    make: Make, seed: int, part: float
) -> None:
    """1 at age_max, 0 at age_max + age_fade and beyond; the other edge keeps its weight."""
    rng = np.random.default_rng(seed)
    gains, u = estimate(rng), {**moving(rng), **received(rng, 2)}
    fading = arrays(age_max=0.5, age_fade=0.2)
    old = two_steps(make(2), {**gains, **fading}, {**u, "age": np.array([0.5 + part * 0.2, 0.1])})
    faded = {**u, "w": u["w"] * [max(0.0, 1 - part), 1.0]}
    expected = two_steps(make(2), {**gains, **arrays(Gamma=np.zeros(3))}, faded)
    for a, b in zip(old, expected, strict=True):
        assert all(np.allclose(a[name], b[name], rtol=1e-10, atol=1e-10) for name in a)


def test_a_fade_changes_nothing_up_to_age_max(make: Make) -> None:
    rng = np.random.default_rng(9)
    gains, u = estimate(rng), {**moving(rng), **received(rng, 2), "age": np.array([0.5, 0.3])}
    free = two_steps(make(2), gains, u)
    watched = two_steps(make(2), {**gains, **arrays(age_max=0.5, age_fade=0.2)}, u)
    for a, b in zip(free, watched, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


# --- gravity ---------------------------------------------------------------------------------


@given(seed=seed, neighbours=st.integers(0, 2))
def test_gravity_is_absent_known_or_adapted(make: Make, seed: int, neighbours: int) -> None:
    rng = np.random.default_rng(seed)
    gains, theta_g = estimate(rng, p=5), rng.uniform(-9, 9, 2)
    u = {**moving(rng), **(received(rng, neighbours) if neighbours else {})}
    law, plain = make(neighbours, gravity=True), make(neighbours)
    without = two_steps(plain, {**gains, "theta_hat": gains["theta_hat"][:3]}, u)
    g_hat, G = gravity(gains["theta_hat"][3:], u["q"]), gravity_regressor(u["q"])
    added = {NONE: np.zeros(2), COMPENSATED: gravity(theta_g, u["q"]), ADAPTED: g_hat}
    for mode, torque in added.items():
        first, second = two_steps(law, {**gains, **arrays(gravity=mode, theta_g=theta_g)}, u)
        assert np.allclose(first["tau"], without[0]["tau"] + torque, rtol=1e-12, atol=1e-11)
        adapted = second["theta_hat"][:3]
        assert np.allclose(adapted, without[1]["theta_hat"], rtol=1e-13, atol=1e-13)
        moved = -H * G.T @ first["s"] if mode == ADAPTED else np.zeros(2)
        expected = gains["theta_hat"][3:] + moved
        assert np.allclose(second["theta_hat"][3:], expected, rtol=1e-13, atol=1e-13)
        assert np.array_equal(second["z"], without[1]["z"])


def test_gravity_is_known_and_never_adapted_by_default() -> None:
    declared = {p.name: p for p in teleoperation.model(gravity=True).parameters()}
    assert declared["gravity"].default == (COMPENSATED,)
    assert declared["theta_hat"].shape == declared["Gamma"].shape == (5,)
    assert "gravity" not in {p.name for p in teleoperation.model().parameters()}


@pytest.mark.parametrize("mode", [-1.0, 3.0, 0.5])
def test_a_gravity_mode_that_is_none_is_refused(make: Make, mode: float) -> None:
    with pytest.raises(CosimError, match="gravity"):
        make(1, gravity=True).initialize(arrays(gravity=mode))


@pytest.mark.parametrize("sizes", [{"neighbours": -1}, {"gravity": 2}])
def test_sizes_that_cannot_be_are_refused(sizes: dict[str, int]) -> None:
    with pytest.raises(CosimError, match="expected at least 0; gravity is"):
        teleoperation.model(**sizes)


@given(seed=seed)
def test_gains_may_be_symmetric_matrices(make: Make, seed: int) -> None:
    """tau = -K s + Y theta_hat and a step of -Gamma Yᵀ s, K and Gamma with entries off diagonal."""
    rng = np.random.default_rng(seed)
    root, factor = rng.uniform(-1, 1, (2, 2)), rng.uniform(-1, 1, (3, 3))
    K, Gamma = root @ root.T + np.eye(2), factor @ factor.T + np.eye(3)
    z, theta_hat, u = rng.uniform(-1, 1, 2), rng.uniform(0.5, 3, 3), moving(rng)
    control = make(0)
    control.initialize(
        arrays(
            K=np.diag(K), K_off=K[0, 1], alpha=0.7, lambda_M=3.0, z=z, theta_hat=theta_hat,
            Gamma=np.diag(Gamma), Gamma_off=Gamma[np.triu_indices(3, 1)],
        )
    )  # fmt: skip
    s = u["dq"] - z
    Y = regressor(u["q"], u["dq"], z, -0.7 * u["dq"] + 3.0 * s)
    assert control.step(0.0, H, u)["tau"] == pytest.approx(-K @ s + Y @ theta_hat, abs=1e-12)
    after = control.step(H, H, u)["theta_hat"]
    assert after == pytest.approx(theta_hat - H * Gamma @ Y.T @ s, abs=1e-12)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"K": [4.0, 1.0], "K_off": 2.0}, "K with K_off .*is not positive definite"),
        (
            {"Gamma": [1.0] * 3, "Gamma_off": [0.9, 0.9, -0.9]},
            "Gamma with Gamma_off .*not positive",
        ),
        ({"Gamma": [0.0] * 3, "Gamma_off": [0.1, 0.0, 0.0]}, "Gamma with Gamma_off .*not positive"),
        (
            {"Gamma_off": [0.1, 0.0, 0.0], "theta_max": [9.0] * 3},
            "theta_max are bounded while Gamma_off",
        ),
    ],
)
def test_gains_that_are_not_positive_definite_are_refused(
    make: Make, values: dict[str, object], said: str
) -> None:
    with pytest.raises(CosimError, match=said):
        control = make(0)
        control.initialize(arrays(**values))
        control.initial(moving(np.random.default_rng(0)))
