"""The operator and xi: two laws of one line each, in NumPy and in C."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.component import Component
from cosim.base.errors import CosimError
from fmus.models import operator, planar2r, xi
from fmus.models.operator import Operator
from fmus.models.planar2r import Planar2R
from fmus.models.xi import Xi

number = st.floats(-1e3, 1e3)
gain = st.floats(0.0, 1e3)
pair = st.tuples(number, number).map(np.array)
gains = st.tuples(gain, gain).map(np.array)


@pytest.fixture(scope="module", params=[Operator, operator.kernel], ids=["numpy", "c"])
def hand(request: pytest.FixtureRequest) -> Component:
    make: Callable[[], Component] = request.param
    return make()


@pytest.fixture(scope="module", params=[Xi, xi.kernel], ids=["numpy", "c"])
def signal(request: pytest.FixtureRequest) -> Component:
    make: Callable[[], Component] = request.param
    return make()


@given(q=pair, dq=pair, k_p=gains, k_d=gains, q_h=pair)
def test_operator_is_a_spring_and_a_damper(
    hand: Component,
    q: np.ndarray,
    dq: np.ndarray,
    k_p: np.ndarray,
    k_d: np.ndarray,
    q_h: np.ndarray,
) -> None:
    hand.initialize({"k_p": k_p, "k_d": k_d, "q_h": q_h})
    expected = -k_d * dq - k_p * (q - q_h)
    assert np.allclose(hand.initial({"q": q, "dq": dq})["tau_h"], expected, rtol=1e-15, atol=0)
    assert np.allclose(hand.step(0.0, 1.0, {"q": q, "dq": dq})["tau_h"], expected, rtol=1e-15)


@given(q=pair, dq=pair, alpha=gain)
def test_xi_is_velocity_plus_alpha_position(
    signal: Component, q: np.ndarray, dq: np.ndarray, alpha: float
) -> None:
    signal.initialize({"alpha": np.array(alpha)})
    assert np.array_equal(signal.initial({"q": q, "dq": dq})["xi"], dq + alpha * q)
    assert np.array_equal(signal.step(0.0, 1.0, {"q": q, "dq": dq})["xi"], dq + alpha * q)


def test_defaults_are_the_paper_s(hand: Component, signal: Component) -> None:
    hand.initialize({})
    signal.initialize({})
    u = {"q": np.array([1.0, 2.0]), "dq": np.array([0.5, -0.5])}
    assert np.allclose(hand.initial(u)["tau_h"], [22.5, 12.5])
    assert np.array_equal(signal.initial(u)["xi"], [1.0, 0.5])


@given(q=pair, dq=pair, k_p=gains, k_d=gains)
def test_operator_outside_the_arm_is_the_grip_inside_it(
    hand: Component, q: np.ndarray, dq: np.ndarray, k_p: np.ndarray, k_d: np.ndarray
) -> None:
    arm = Planar2R()
    arm.initialize({"q": q, "dq": dq, "k_p": k_p, "k_d": k_d})
    hand.initialize({"k_p": k_p, "k_d": k_d, "q_h": np.zeros(2)})
    inside = arm.initial({"tau": np.zeros(2), "tau_ext": np.zeros(2)})["tau_h"]
    assert np.allclose(hand.initial({"q": q, "dq": dq})["tau_h"], inside, rtol=1e-15, atol=0)


def test_sampled_or_continuous_is_declared() -> None:
    kinds = [module.model().kind for module in (operator, xi, planar2r)]
    assert kinds == ["sampled", "sampled", "continuous"]


def test_a_gain_that_is_not_finite_or_negative_is_refused(hand: Component) -> None:
    for bad in (np.nan, -1.0):
        with pytest.raises(CosimError, match="k_d"):
            hand.initialize({"k_d": np.array([bad, 1.0])})
            hand.initial({"q": np.zeros(2), "dq": np.zeros(2)})
