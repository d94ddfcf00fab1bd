"""Damping with gravity compensation: Theorem 1 of the paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.component import Component
from fmus.arms.dynamics import gravity
from fmus.models import damping, planar2r
from fmus.models.damping import Damping
from tests.fmus.loops import Values, arrays, closed, norm

number = st.floats(-30.0, 30.0)
pair = st.tuples(number, number).map(np.array)
seed = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module", params=[Damping, damping.kernel], ids=["numpy", "c"], name="law")
def law_(request: pytest.FixtureRequest) -> Component:
    make: Callable[[], Component] = request.param
    return make()


def start(preset: str = "SL91-upright", **values: object) -> tuple[Values, Values]:
    """(values of an arm, the gravity that its platform knows)."""
    arm = {name: np.array(value) for name, value in planar2r.PRESETS[preset].items()}
    known = {name: value for name, value in arm.items() if name == "theta_g"}
    return arm | arrays(**values), known


@given(q=pair, dq=pair, d=st.floats(0, 30), theta_g=pair)
def test_the_torque_is_that_of_gravity_less_the_damping(
    law: Component, q: np.ndarray, dq: np.ndarray, d: float, theta_g: np.ndarray
) -> None:
    law.initialize(arrays(d=[d, 2 * d], theta_g=theta_g))
    expected = -np.array([d, 2 * d]) * dq + gravity(theta_g, q)
    for y in (law.initial({"q": q, "dq": dq}), law.step(0.0, 1.0, {"q": q, "dq": dq})):
        assert np.allclose(y["tau"], expected, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("preset", ["SL91", "SL91-upright", "unit-upright"])
def test_a_constant_push_ends_in_the_velocity_torque_over_damping(preset: str) -> None:
    """Of the first joint: straight out (q2 = 0) the second one has no reason to turn."""
    arm, known = start(preset, substeps=2)
    push = np.array([0.5, 0.0])
    law, gains = damping.kernel(), arrays(d=[2.0, 2.0]) | known
    run = closed(arm, law, gains, 2e-3, 10000, lambda t, q, dq: push)
    assert np.allclose(run["dq"][-1], push / 2.0, rtol=1e-2, atol=1e-2)
    assert np.abs(run["q"][-1, 0] - run["q"][0, 0]) > 3.0


@settings(max_examples=15)
@given(seed=seed)
def test_the_gain_from_a_push_to_the_velocity_is_at_most_one_over_the_damping(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm, known = start(q=rng.uniform(-3, 3, 2), substeps=2)
    d, levels = rng.uniform(1, 10, 2), rng.uniform(-5, 5, (8, 2))
    law, h = damping.kernel(), 1e-3
    run = closed(arm, law, {"d": d, **known}, h, 1000, lambda t, q, dq: levels[int(t / 0.125)])
    assert norm(run["dq"], h) < 1.01 * norm(run["push"], h) / d.min()


def test_free_the_arm_comes_to_rest_wherever_it_is() -> None:
    arm, known = start(q=[0.4, 1.0], dq=[1.5, -2.0], substeps=2)
    run = closed(arm, damping.kernel(), known, 2e-3, 5000)
    assert np.abs(run["dq"][-1]).max() < 1e-3
    assert np.abs(run["q"][-1] - [0.4, 1.0]).max() > 0.1


def test_without_the_torque_of_gravity_the_arm_falls() -> None:
    arm, _ = start(q=[0.4, 1.0], substeps=2)
    run = closed(arm, damping.kernel(), {}, 2e-3, 5000)
    hanging = np.array([run["q"][-1, 0], run["q"][-1].sum()])
    assert np.allclose(np.sin(hanging), -1.0, atol=1e-2)
