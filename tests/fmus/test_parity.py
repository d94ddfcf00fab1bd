"""Equal numbers: NumPy and C to 1e-12; C called directly and through FMI 2.0 and 3.0 to the bit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from cosim.base.component import Component
from fmus.build import toolchain
from fmus.build.library import compile_model
from fmus.models import adaptive, damping, operator, planar2r, pointmass, teleoperation, xi
from fmus.models.adaptive import Adaptive
from fmus.models.damping import Damping
from fmus.models.operator import Operator
from fmus.models.planar2r import PRESETS, Planar2R
from fmus.models.pointmass import PointMass
from fmus.models.teleoperation import Teleoperation
from fmus.models.xi import Xi

Values = dict[str, np.ndarray]
EXAMPLES, STEPS = 4, 200  # 800 random steps of each model

seed = st.integers(0, 2**32 - 1)


@dataclass(frozen=True)
class Case:
    """One model: how to make its components, and values it is at home with."""

    module: ModuleType
    reference: Callable[..., Component]
    draw: Callable[[np.random.Generator], Values]
    sizes: Mapping[str, int]

    def __str__(self) -> str:
        return str(self.module.model(**self.sizes).identifier)


def arm_values(rng: np.random.Generator) -> Values:
    """A preset in a damped grip, with a wall of any law on either side of where the hand may be."""
    preset = list(PRESETS.values())[rng.integers(len(PRESETS))]
    return {
        **{name: np.array(value) for name, value in preset.items()},
        "q": rng.uniform(-3, 3, 2),
        "dq": rng.uniform(-1, 1, 2),
        "k_p": rng.uniform(1, 20, 2),
        "k_d": rng.uniform(4, 10, 2),
        "k_w": rng.uniform(0, 300, 2),
        "b_w": rng.uniform(0, 3, 2),
        "q_w": rng.uniform(-3, 3, 2),
        "contact": np.array(float(rng.integers(0, 3))),
        "substeps": np.array(float(rng.integers(1, 3))),
    }


def controller_values(rng: np.random.Generator) -> Values:
    """Gains around the paper's; now and then limits, bounds and Remark 3."""
    return {
        "K": rng.uniform(1, 20, 2),
        "K_off": np.array(rng.choice([0.0, -0.9, 0.9])),
        "alpha": np.array(rng.uniform(0.1, 2)),
        "lambda_M": np.array(rng.choice([0.0, 1.0, 6.0, 10.0])),
        "lambda_c": np.array(rng.choice([0.0, 0.0, 5.0])),
        "tau_max": rng.choice([40.0, 1e9]) * np.ones(2),
        "z": rng.uniform(-1, 1, 2),
    }


def estimate_values(rng: np.random.Generator, p: int) -> Values:
    """Of theta_hat with p entries; every other time within bounds that are met."""
    bounded = bool(rng.integers(2))
    entries = p * (p - 1) // 2  # right of the diagonal, small enough for a positive matrix
    return {
        "Gamma": rng.uniform(0.2, 1, p),
        "Gamma_off": np.zeros(entries) if bounded else rng.uniform(-0.04, 0.04, entries),
        "theta_hat": rng.uniform(0.5, 3, p),
        "theta_min": np.full(p, 0.1 if bounded else -1e9),
        "theta_max": np.full(p, 4.0 if bounded else 1e9),
    }


def network_values(rng: np.random.Generator) -> Values:
    return {
        "lambda": np.array(rng.uniform(0, 3)),
        "age_max": np.array(rng.choice([1.5, 1e9])),
        "age_fade": np.array(rng.choice([0.0, 0.75])),
    }


def gravity_values(rng: np.random.Generator) -> Values:
    return {"theta_g": rng.uniform(-9, 9, 2), "gravity": np.array(float(rng.integers(0, 3)))}


def neighbour_values(rng: np.random.Generator) -> Values:
    return controller_values(rng) | estimate_values(rng, 3) | network_values(rng)


def neighbour_gravity_values(rng: np.random.Generator) -> Values:
    return neighbour_values(rng) | estimate_values(rng, 5) | gravity_values(rng)


def adaptive_values(rng: np.random.Generator) -> Values:
    return controller_values(rng) | estimate_values(rng, 3) | {"alpha": np.array(0.0)}


def adaptive_gravity_values(rng: np.random.Generator) -> Values:
    return controller_values(rng) | estimate_values(rng, 5) | gravity_values(rng)


def damping_values(rng: np.random.Generator) -> Values:
    return {"d": rng.uniform(0, 20, 2), "theta_g": rng.uniform(-30, 30, 2)}


def pointmass_values(rng: np.random.Generator) -> Values:
    return {
        "m": np.array(rng.uniform(0.1, 5)),
        "b": np.array(rng.choice([0.0, 1e-3, 1.0, 1e4])),
        "x": np.array(rng.uniform(-1, 1)),
        "dx": np.array(rng.uniform(-1, 1)),
    }


def operator_values(rng: np.random.Generator) -> Values:
    return {name: rng.uniform(0, 50, 2) for name in ("k_p", "k_d", "q_h")}


def xi_values(rng: np.random.Generator) -> Values:
    return {"alpha": np.array(rng.uniform(0, 5))}


CASES = [
    Case(planar2r, Planar2R, arm_values, {}),
    Case(teleoperation, Teleoperation, neighbour_values, {}),
    Case(teleoperation, Teleoperation, neighbour_values, {"neighbours": 2}),
    Case(teleoperation, Teleoperation, neighbour_gravity_values, {"neighbours": 2, "gravity": 1}),
    Case(adaptive, Adaptive, adaptive_values, {}),
    Case(adaptive, Adaptive, adaptive_gravity_values, {"gravity": 1}),
    Case(damping, Damping, damping_values, {}),
    Case(pointmass, PointMass, pointmass_values, {}),
    Case(operator, Operator, operator_values, {}),
    Case(xi, Xi, xi_values, {}),
]


def inputs(component: Component, rng: np.random.Generator) -> Values:
    """Inputs at random, of the size of a working robot's; grip and friction only damp."""
    return {
        port.name: rng.uniform(0 if port.name in ("grip", "b_add") else -3, 3, port.shape)
        for port in component.inputs
    }


def differ(a: Mapping[str, ArrayLike], b: Mapping[str, ArrayLike]) -> list[str]:
    """The outputs that differ by more than 1e-12 of the larger of 1 and their greatest entry."""

    def far(name: str) -> bool:
        x, y = np.array(a[name]), np.array(b[name])
        return not np.abs(x - y).max() <= 1e-12 * max(1.0, np.abs(y).max())

    return [name for name in a if far(name)]


@pytest.mark.parametrize("case", CASES, ids=str)
@settings(max_examples=EXAMPLES)
@given(seed=seed)
def test_numpy_and_c_agree_over_random_steps(case: Case, seed: int) -> None:
    rng = np.random.default_rng(seed)
    reference, kernel = case.reference(**case.sizes), case.module.kernel(**case.sizes)
    values, h = case.draw(rng), float(rng.choice([1e-3, 2e-3, 5e-3]))
    reference.initialize(values)
    kernel.initialize(values)
    for k in range(STEPS):
        if k == STEPS // 3:
            saved = reference.get_state(), kernel.get_state()
        if k == STEPS // 2:
            reference.set_state(saved[0])
            kernel.set_state(saved[1])
        u = inputs(reference, rng)
        a, b = reference.step(k * h, h, u), kernel.step(k * h, h, u)
        assert not differ(a, b), (k, a, b)


@pytest.mark.parametrize("case", CASES, ids=str)
@settings(max_examples=20)
@given(seed=seed)
def test_numpy_and_c_agree_at_the_start(case: Case, seed: int) -> None:
    rng = np.random.default_rng(seed)
    reference, kernel = case.reference(**case.sizes), case.module.kernel(**case.sizes)
    values, u = case.draw(rng), inputs(reference, rng)
    reference.initialize(values)
    kernel.initialize(values)
    assert not differ(reference.initial(u), kernel.initial(u))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_numpy_and_c_have_the_same_ports_and_defaults(case: Case) -> None:
    reference, kernel = case.reference(**case.sizes), case.module.kernel(**case.sizes)
    assert reference.kind == kernel.kind
    assert reference.inputs == kernel.inputs
    assert reference.outputs == kernel.outputs
    assert reference.parameters == kernel.parameters
    reference.initialize({})
    kernel.initialize({})
    u = inputs(reference, np.random.default_rng(3))
    a, b = reference.initial(u), kernel.initial(u)
    assert list(a) == list(b) == [port.name for port in reference.outputs]
    assert not differ(a, b)


FULL = {  # every part of the C code in use
    "planar2r": {"theta_g": np.array([24.5, 11.8]), "contact": np.array(2.0)},
    "teleoperation": {"lambda_c": np.array(0.0)},
    "adaptive_gravity": {"gravity": np.array(2.0), "lambda_c": np.array(5.0)},
}


def trajectory(case: Case) -> bytes:
    """Every output of many random steps of the kernel."""
    rng = np.random.default_rng(4)
    kernel = case.module.kernel(**case.sizes)
    kernel.initialize(case.draw(rng) | FULL[str(case)])
    rows = [kernel.step(k * 5e-3, 5e-3, inputs(kernel, rng)) for k in range(STEPS)]
    return np.array([np.concatenate([np.ravel(v) for v in y.values()]) for y in rows]).tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("case", [CASES[0], CASES[1], CASES[5]], ids=str)
def test_another_compiler_makes_the_same_numbers(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = trajectory(case)
    monkeypatch.setattr(toolchain, "host_compiler", lambda: None)
    model = case.module.model(**case.sizes)
    (binary,) = compile_model(model).values()
    library = tmp_path / model.identifier
    library.write_bytes(binary)
    monkeypatch.setattr("fmus.build.kernel.library", lambda _: library)
    assert trajectory(case) == here
