"""The adaptive controller: what its equations promise, in NumPy and in C."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.arms.dynamics import regressor
from fmus.models import teleoperation
from fmus.models.teleoperation import Teleoperation

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


def drawn(rng: np.random.Generator, neighbours: int = 1) -> dict[str, np.ndarray]:
    """Inputs at random."""
    return {
        "q": rng.uniform(-3, 3, 2),
        "dq": rng.uniform(-2, 2, 2),
        "xi_in": rng.uniform(-3, 3, (neighbours, 2)),
        "w": rng.uniform(0, 1, neighbours),
    }


def kept(outputs: Mapping[str, ArrayLike]) -> dict[str, np.ndarray]:
    """Outputs that the next step does not overwrite."""
    return {name: np.array(value) for name, value in outputs.items()}


@given(seed=seed)
def test_step_is_the_law_and_one_step_of_euler(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    controller, u = make(), drawn(rng)
    z, theta_hat = rng.uniform(-2, 2, 2), rng.uniform(0, 4, 3)
    controller.initialize({"z": z, "theta_hat": theta_hat})
    xi = u["dq"] + 0.5 * u["q"]
    dz = -0.5 * u["dq"] + 10 * (u["dq"] - z) - 2 * u["w"][0] * (xi - u["xi_in"][0])
    s = u["dq"] - z
    Y = regressor(u["q"], u["dq"], z, dz)
    first, second = kept(controller.step(0.0, H, u)), controller.step(H, H, u)
    expected = {"xi": xi, "s": s, "z": z, "theta_hat": theta_hat, "tau": -16 * s + Y @ theta_hat}
    for name, value in expected.items():
        assert np.allclose(first[name], value, rtol=1e-12, atol=1e-12), name
    assert np.allclose(second["z"], z + H * dz, rtol=1e-12, atol=1e-12)
    assert np.allclose(second["theta_hat"], theta_hat - H * Y.T @ s, rtol=1e-12, atol=1e-12)


@given(seed=seed)
def test_outputs_at_the_start_are_those_of_the_first_step(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    controller = make()
    controller.initialize({"z": rng.uniform(-2, 2, 2), "theta_hat": rng.uniform(0, 4, 3)})
    controller.initial(drawn(rng))
    u = drawn(rng)
    start = kept(controller.initial(u))
    first = controller.step(0.0, H, u)
    assert all(np.array_equal(start[name], first[name]) for name in start)


@given(seed=seed)
def test_degenerate_gain_leaves_pure_damping(make: Make, seed: int) -> None:
    """With lambda_M = alpha, z(0) = 0 and no neighbour: z = 0, theta_hat = 0, tau = -K dq."""
    rng = np.random.default_rng(seed)
    controller = make()
    controller.initialize({"lambda_M": np.array(0.5), "alpha": np.array(0.5)})
    for k in range(20):
        u = {**drawn(rng), "w": np.zeros(1)}
        y = controller.step(k * H, H, u)
        assert np.array_equal(np.abs(y["z"]), np.zeros(2))
        assert np.array_equal(np.abs(y["theta_hat"]), np.zeros(3))
        assert np.allclose(y["tau"], -16 * u["dq"], rtol=1e-14)


def follow(
    controller: Component, inputs: list[dict[str, np.ndarray]], values: dict[str, np.ndarray]
) -> np.ndarray:
    """tau, z and theta_hat of every step, a row a step."""
    controller.initialize(values)
    rows = [kept(controller.step(k * H, H, u)) for k, u in enumerate(inputs)]
    return np.array([np.concatenate([y["tau"], y["z"], y["theta_hat"]]) for y in rows])


@settings(max_examples=20)
@given(seed=seed)
def test_a_neighbour_of_weight_zero_is_no_neighbour(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    two = [{**drawn(rng, 2), "w": np.array([0.7, 0.0])} for _ in range(10)]
    one = [{**u, "xi_in": u["xi_in"][:1], "w": u["w"][:1]} for u in two]
    assert np.array_equal(follow(make(neighbours=2), two, {}), follow(make(), one, {}))


@settings(max_examples=20)
@given(seed=seed)
def test_the_order_of_neighbours_does_not_matter(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    inputs = [drawn(rng, 2) for _ in range(10)]
    swapped = [{**u, "xi_in": u["xi_in"][::-1], "w": u["w"][::-1]} for u in inputs]
    a, b = (follow(make(neighbours=2), u, {}) for u in (inputs, swapped))
    assert np.allclose(a, b, rtol=1e-12, atol=1e-12)


@settings(max_examples=20)
@given(seed=seed)
def test_lambda_and_weight_act_as_their_product(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    inputs = [drawn(rng) for _ in range(10)]
    doubled = [{**u, "w": 2 * u["w"]} for u in inputs]
    a = follow(make(), inputs, {"lambda": np.array(2.0)})
    b = follow(make(), doubled, {"lambda": np.array(1.0)})
    assert np.allclose(a, b, rtol=1e-13, atol=1e-13)


@given(seed=seed)
def test_at_the_torque_limit_the_states_stand_still(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    controller, limit = make(), np.array([3.0, 20.0])
    values = {"z": rng.uniform(-1, 1, 2), "theta_hat": rng.uniform(0, 2, 3), "tau_max": limit}
    controller.initialize(values)
    seen = [kept(controller.step(k * H, H, drawn(rng))) for k in range(10)]
    for now, following in pairwise(seen):
        assert (np.abs(now["tau"]) <= limit).all()
        stood = [np.array_equal(now[name], following[name]) for name in ("z", "theta_hat")]
        assert stood == [bool((np.abs(now["tau"]) == limit).any())] * 2


def test_a_saturated_controller_takes_up_again_where_it_stood(make: Make) -> None:
    controller = make()
    controller.initialize({"tau_max": np.full(2, 10.0)})
    fast = {"q": np.zeros(2), "dq": np.full(2, 5.0), "xi_in": np.zeros((1, 2)), "w": np.ones(1)}
    for k in range(100):
        assert np.array_equal(controller.step(k * H, H, fast)["tau"], [-10.0, -10.0])
    slow = {**fast, "dq": np.full(2, 0.25)}
    y = controller.step(100 * H, H, slow)
    assert np.allclose(y["tau"], [-4.0, -4.0])
    assert np.array_equal(y["theta_hat"], np.zeros(3))


@settings(max_examples=20)
@given(seed=seed)
def test_a_saved_state_continues_exactly(make: Make, seed: int) -> None:
    rng = np.random.default_rng(seed)
    controller, inputs = make(neighbours=2), [drawn(rng, 2) for _ in range(8)]
    follow(controller, inputs[:4], {})
    saved = controller.get_state()
    first = [kept(controller.step(k * H, H, inputs[k])) for k in range(4, 8)]
    controller.set_state(saved)
    again = [kept(controller.step(k * H, H, inputs[k])) for k in range(4, 8)]
    assert all(
        np.array_equal(a[name], b[name]) for a, b in zip(first, again, strict=True) for name in a
    )


@pytest.mark.parametrize("name", ["q", "dq", "xi_in", "w"])
def test_an_input_that_is_not_finite_is_named_and_changes_nothing(make: Make, name: str) -> None:
    controller, u = make(), drawn(np.random.default_rng(1))
    controller.initialize({"z": np.array([0.5, -0.5])})
    with pytest.raises(CosimError, match=rf"\b{name}\b"):
        controller.step(0.0, H, {**u, name: np.full(u[name].shape, np.nan)})
    again = kept(controller.step(0.0, H, u))
    controller.initialize({"z": np.array([0.5, -0.5])})
    first = controller.step(0.0, H, u)
    assert all(np.array_equal(first[port], again[port]) for port in again)


def test_values_it_cannot_take_are_refused_with_their_name(make: Make) -> None:
    for values in ({"alpha": -1.0}, {"K": [1.0, np.inf]}, {"xi": [0.0, 0.0]}, {"Gamma": [1.0]}):
        with pytest.raises(CosimError, match=next(iter(values))):
            make().initialize({name: np.array(value) for name, value in values.items()})
