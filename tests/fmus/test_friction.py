"""Friction of joints: viscous, and dry friction that is smooth near rest."""

from __future__ import annotations

from math import tanh

import numpy as np
import pytest

from cosim.base.component import Component
from fmus.models import friction
from fmus.models.friction import Friction

pytestmark = pytest.mark.usefixtures("compiled_once")
VALUES = {
    "damping": np.array([0.5, 0.0]),
    "friction": np.array([1.0, 2.0]),
    "v_f": np.array([0.05, 0.2]),
}


@pytest.fixture(params=[Friction, friction.kernel], ids=["numpy", "c"])
def joints(request: pytest.FixtureRequest) -> Component:
    made: Component = request.param()
    return made


def torque(component: Component, dq: list[float]) -> np.ndarray:
    return np.asarray(component.step(0.0, 1e-3, {"dq": np.array(dq)})["tau"])


def test_by_default_there_is_none(joints: Component) -> None:
    joints.initial({"dq": np.zeros(2)})
    assert not torque(joints, [1.0, -3.0]).any()


def test_it_opposes_the_motion_and_dry_friction_does_not_grow_with_it(joints: Component) -> None:
    joints.initialize(VALUES)
    joints.initial({"dq": np.zeros(2)})
    assert torque(joints, [2.0, -2.0]) == pytest.approx([-2.0, 2.0], abs=1e-8)
    assert torque(joints, [4.0, -9.0]) == pytest.approx([-3.0, 2.0], abs=1e-8)
    assert torque(joints, [0.05, 0.2]) == pytest.approx([-0.025 - tanh(1.0), -2 * tanh(1.0)])
    assert torque(joints, [1e-5, 0.0]) == pytest.approx([-20.5e-5, 0.0], rel=1e-6)
