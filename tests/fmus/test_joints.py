"""Models whose law treats every joint alike, for arms of any number of joints."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from cosim.base.errors import FmuError
from fmus.arms.joints import Joints
from fmus.build.reference import Reference
from fmus.models import (
    decaying_push,
    lee_spong,
    minimum_jerk,
    operator,
    p_d,
    pd,
    push,
    reaction,
    tdpa_admittance,
    tdpa_impedance,
    wave_admittance,
    wave_impedance,
    wave_integral_admittance,
    wave_integral_impedance,
    xi,
)
from tests.fmus.test_parity import inputs
from tests.fmus.test_parity_fmi import Slave

MODELS = [
    decaying_push,
    lee_spong,
    minimum_jerk,
    operator,
    p_d,
    pd,
    push,
    reaction,
    tdpa_admittance,
    tdpa_impedance,
    wave_admittance,
    wave_impedance,
    wave_integral_admittance,
    wave_integral_impedance,
    xi,
]
pytestmark = pytest.mark.usefixtures("compiled_once")

Values = dict[str, np.ndarray]
H = 5e-3


def name_of(module: ModuleType) -> str:
    return str(module.model().identifier)


def reference(module: ModuleType, joints: int = 2) -> Reference:
    return Reference(module.model(joints), module.law, getattr(module, "start", None))


def random_values(module: ModuleType, joints: int, rng: np.random.Generator) -> Values:
    """A value for each parameter, also for those of the joints that are 0 by default."""
    return {
        v.name: rng.uniform(0.1, 1.0, v.shape) * np.maximum(1.0, np.array(v.starts)[:1]).item()
        for v in module.model(joints).variables
        if v.causality == "parameter" and v.name not in ("reaction", "T", "t_0", "t_1")
    }


def of_two(values: Values, shapes: dict[str, tuple[int, ...]]) -> Values:
    """The values of the first two joints, of those that have one for each joint."""
    return {name: value[tuple(map(slice, shapes[name]))] for name, value in values.items()}


@pytest.mark.parametrize("module", MODELS, ids=name_of)
def test_the_first_two_of_seven_joints_move_as_those_of_an_arm_of_two(module: ModuleType) -> None:
    """NumPy and C; each joint's equations do not contain the other joints."""
    for make in (module.kernel, partial(reference, module)):
        rng = np.random.default_rng(7)
        seven, two = make(joints=7), make()
        shapes = {v.name: v.shape for v in module.model().variables}
        values = random_values(module, 7, rng)
        seven.initialize(values)
        two.initialize(of_two(values, shapes))
        u = inputs(seven, rng)
        pairs = [(seven.initial(u), two.initial(of_two(u, shapes)))]
        for k in range(50):
            u = inputs(seven, rng)
            step = k * H, H
            pairs.append((seven.step(*step, u), two.step(*step, of_two(u, shapes))))
        for of_seven, expected in pairs:
            assert all(of_seven[p.name].shape == p.shape for p in seven.outputs)
            found = of_two(of_seven, shapes)
            assert all(np.array_equal(found[p.name], expected[p.name]) for p in two.outputs)


@pytest.mark.parametrize("module", MODELS, ids=name_of)
def test_numpy_and_c_agree_for_the_last_of_seven_joints(module: ModuleType) -> None:
    rng = np.random.default_rng(9)
    kernel = module.kernel(joints=7)
    values, u = random_values(module, 7, rng), inputs(kernel, rng)
    found = []
    for component in (kernel, reference(module, 7)):
        component.initialize(values)
        component.initial(u)
        found.append([component.step(k * H, H, u) for k in range(3)])
    for a, b in zip(*found, strict=True):
        assert all(np.allclose(a[name], b[name], rtol=0, atol=1e-12) for name in b)


def test_a_controller_of_seven_joints_is_an_fmu(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    kernel = pd.kernel(joints=7)
    slave = Slave(pd.fmu("3.0", joints=7), tmp_path, kernel)
    values, u = random_values(pd, 7, rng), inputs(kernel, rng)
    kernel.initialize(values)
    started = slave.start(values, u)
    assert np.array_equal(started["tau"], kernel.initial(u)["tau"])
    assert started["tau"].shape == (7,)
    slave.fmu.terminate()
    slave.fmu.freeInstance()


@pytest.mark.parametrize("count", [0, -1, 2.5, True])
def test_a_number_of_joints_that_cannot_be_is_refused(count: int) -> None:
    with pytest.raises(FmuError, match=r"joints is .*; expected a whole number of at least 1"):
        Joints(count)
