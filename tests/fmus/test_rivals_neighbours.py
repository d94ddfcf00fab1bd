"""Adaptive laws with several neighbours: C and NumPy, and what they reduce to with one."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from cosim.base.component import Component
from cosim.base.errors import FmuError
from fmus.models import abdessameud2014, chopra, nuno_adaptive, wang2014

H = 5e-3
REFERENCES: dict[ModuleType, Any] = {
    nuno_adaptive: nuno_adaptive.NunoAdaptive,
    wang2014: wang2014.Wang2014,
    chopra: chopra.Chopra,
    abdessameud2014: abdessameud2014.Abdessameud2014,
}
#: The gain that couples one neighbour as two equal ones do where the law adds them up.
DOUBLED = {wang2014: {"lambda": np.array(2.0)}, chopra: {"K": np.full(2, 32.0)}}
pytestmark = [
    pytest.mark.usefixtures("compiled_once"),
    pytest.mark.parametrize("module", REFERENCES, ids=lambda m: m.__name__.split(".")[-1]),
]


def played(component: Component, u: list[dict[str, np.ndarray]]) -> list[np.ndarray]:
    """Torque and estimate of every step."""
    component.initial(u[0])
    steps = [component.step(k * H, H, x) for k, x in enumerate(u)]
    return [np.concatenate([np.asarray(y["tau"]), np.asarray(y["theta_hat"])]) for y in steps]


def motion(component: Component, steps: int, seed: int) -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    return [{p.name: rng.uniform(-2, 2, p.shape) for p in component.inputs} for _ in range(steps)]


def test_c_equals_numpy_with_three_neighbours(module: ModuleType) -> None:
    reference, kernel = REFERENCES[module](neighbours=3), module.kernel(neighbours=3)
    assert {p.shape for p in reference.inputs} == {(2,), (3, 2)}
    u = motion(reference, 40, 7)
    assert np.allclose(played(kernel, u), played(reference, u), rtol=1e-12, atol=1e-12)


def test_each_neighbour_counts(module: ModuleType) -> None:
    component = REFERENCES[module](neighbours=2)
    for port in component.inputs[2:]:
        u = motion(component, 4, 3)
        before = played(component, u)[-1]
        for row in range(2):
            changed = [{**x, port.name: x[port.name] + np.eye(2)[row][:, None]} for x in u]
            component.initialize({})
            assert not np.allclose(played(component, changed)[-1], before)
        component.initialize({})


def test_two_equal_neighbours_are_one_with_the_sum_or_the_mean_of_the_gains(
    module: ModuleType,
) -> None:
    one, two = REFERENCES[module](), REFERENCES[module](neighbours=2)
    if module in DOUBLED:
        one.initialize(DOUBLED[module])
    u = motion(one, 20, 5)
    received = {p.name for p in two.inputs if p.shape == (2, 2)}
    both = [{k: np.tile(v, (2, 1)) if k in received else v for k, v in x.items()} for x in u]
    assert np.allclose(played(one, u), played(two, both), rtol=1e-12, atol=1e-12)


def test_no_neighbour_is_refused(module: ModuleType) -> None:
    with pytest.raises(FmuError, match="neighbours is 0; expected at least 1"):
        module.model(neighbours=0)
