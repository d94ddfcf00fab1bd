"""Rivals and operators: NumPy and C agree to 1e-12, C and its FMUs to the bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.base.component import Component, Outputs
from cosim.base.errors import CosimError
from fmus.build import toolchain
from fmus.build.library import compile_model
from fmus.models import (
    abdessameud2014,
    chopra,
    decaying_push,
    endpoint_operator,
    grasp,
    lee_spong,
    minimum_jerk,
    nuno_adaptive,
    p_d,
    pd,
    push,
    reaction,
    tdpa_admittance,
    tdpa_impedance,
    wang2014,
    wave_admittance,
    wave_impedance,
    wave_integral_admittance,
    wave_integral_impedance,
)
from tests.fmus.test_parity import differ, inputs
from tests.fmus.test_parity_fmi import Slave, Version

Values = dict[str, np.ndarray]
H = 5e-3


@dataclass(frozen=True)
class Case:
    """A model and its reference; `state`: whether a step depends on the steps before."""

    module: ModuleType
    reference: Callable[[], Component]
    state: bool = False

    def __str__(self) -> str:
        return str(self.module.model().identifier)


CASES = [
    Case(pd, pd.PD),
    Case(p_d, p_d.PPlusD),
    Case(lee_spong, lee_spong.LeeSpong),
    Case(nuno_adaptive, nuno_adaptive.NunoAdaptive, True),
    Case(chopra, chopra.Chopra, True),
    Case(wang2014, wang2014.Wang2014, True),
    Case(abdessameud2014, abdessameud2014.Abdessameud2014, True),
    Case(wave_impedance, wave_impedance.WaveImpedance),
    Case(wave_admittance, wave_admittance.WaveAdmittance, True),
    Case(wave_integral_impedance, wave_integral_impedance.WaveIntegralImpedance, True),
    Case(wave_integral_admittance, wave_integral_admittance.WaveIntegralAdmittance, True),
    Case(tdpa_impedance, tdpa_impedance.TdpaImpedance, True),
    Case(tdpa_admittance, tdpa_admittance.TdpaAdmittance, True),
    Case(endpoint_operator, endpoint_operator.EndpointOperator),
    Case(minimum_jerk, minimum_jerk.MinimumJerk),
    Case(reaction, reaction.Reaction, True),
    Case(push, push.Push),
    Case(decaying_push, decaying_push.DecayingPush),
    Case(grasp, grasp.Grasp),
]
#: Values that are not scaled versions of the default.
RANGES = {"t_0": (0.0, 0.5), "t_1": (0.5, 1.5), "T": (0.2, 1.0), "times": (0.0, 1.5)}


def values_of(module: ModuleType, rng: np.random.Generator) -> Values:
    """Parameters and start values around the defaults; every other time torques are limited."""
    found = {}
    for v in module.model().variables:
        start = np.array(v.starts).reshape(v.shape)
        if v.name == "tau_max":
            found[v.name] = rng.choice([20.0, 1e9]) * np.ones(v.shape)
        elif v.type == "integer":
            found[v.name] = np.array(float(rng.integers(2)))
        elif v.name in RANGES:
            found[v.name] = rng.uniform(*RANGES[v.name], v.shape)
        elif v.causality == "parameter" or v.settable:
            found[v.name] = start * rng.uniform(0.3, 2, v.shape) + (start == 0) * rng.random(
                v.shape
            )
    return found


@pytest.mark.parametrize("case", CASES, ids=str)
@settings(max_examples=4)
@given(seed=st.integers(0, 2**32 - 1))
def test_numpy_and_c_agree_over_random_steps(case: Case, seed: int) -> None:
    """1 200 steps of each law with a state, 400 of each without."""
    rng = np.random.default_rng(seed)
    reference, kernel, steps = case.reference(), case.module.kernel(), 300 if case.state else 100
    values, u = values_of(case.module, rng), inputs(reference, rng)
    reference.initialize(values)
    kernel.initialize(values)
    assert not differ(reference.initial(u), kernel.initial(u))
    a: list[Outputs] = []
    b: list[Outputs] = []
    for k in range(steps):
        if k == steps // 3:
            saved = reference.get_state(), kernel.get_state()
        if k == steps // 2:
            reference.set_state(saved[0])
            kernel.set_state(saved[1])
        u = inputs(reference, rng)
        a.append(reference.step(k * H, H, u))
        b.append(kernel.step(k * H, H, u))
    for name in a[0]:
        x, y = (np.array([row[name] for row in rows]) for rows in (a, b))
        assert (np.abs(x - y) <= 1e-12 * np.maximum(1.0, np.abs(y))).all(), name


@pytest.mark.parametrize("case", CASES, ids=str)
def test_numpy_and_c_have_the_same_ports_and_defaults(case: Case) -> None:
    reference, kernel = case.reference(), case.module.kernel()
    assert reference.kind == kernel.kind == "sampled"
    assert reference.inputs == kernel.inputs
    assert reference.outputs == kernel.outputs
    assert reference.parameters == kernel.parameters
    reference.initialize({})
    kernel.initialize({})
    u = inputs(reference, np.random.default_rng(3))
    a, b = reference.initial(u), kernel.initial(u)
    assert list(a) == list(b) == [port.name for port in reference.outputs]
    assert not differ(a, b)


@pytest.fixture(params=["2.0", "3.0"])
def version(request: pytest.FixtureRequest) -> Version:
    chosen: Version = request.param
    return chosen


@pytest.fixture(params=CASES, ids=str)
def pair(
    request: pytest.FixtureRequest, version: Version, tmp_path: Path
) -> Iterator[tuple[ModuleType, Component, Slave]]:
    module = request.param.module
    kernel = module.kernel()
    slave = Slave(module.fmu(version), tmp_path, kernel)
    yield module, kernel, slave
    slave.fmu.terminate()
    slave.fmu.freeInstance()


def test_fmu_and_kernel_are_the_same_to_the_bit(
    pair: tuple[ModuleType, Component, Slave],
) -> None:
    module, kernel, slave = pair
    rng = np.random.default_rng(1)
    values, u = values_of(module, rng), inputs(kernel, rng)
    kernel.initialize(values)
    assert same(kernel.initial(u), slave.start(values, u))
    for k in range(200):
        u = inputs(kernel, rng)
        assert same(kernel.step(k * H, H, u), slave.step(k, u)), k


def same(a: object, b: Values) -> bool:
    assert isinstance(a, dict)
    return all(np.array(a[name]).tobytes() == np.array(b[name]).tobytes() for name in b)


@pytest.mark.parametrize("case", [c for c in CASES if c.module.model().inputs()], ids=str)
def test_an_input_that_is_not_finite_is_named_and_changes_nothing(case: Case) -> None:
    for make in (case.reference, case.module.kernel):
        component, rng = make(), np.random.default_rng(5)
        component.initialize({})
        u = inputs(component, rng)
        component.initial(u)
        component.step(0.0, H, u)
        saved = component.get_state()
        for port in component.inputs:
            with pytest.raises(CosimError, match=rf"\b{port.name}\b"):
                component.step(H, H, {**u, port.name: np.full(port.shape, np.nan)})
        after = component.step(H, H, u)
        component.set_state(saved)
        assert not differ(component.step(H, H, u), after)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_outputs_depend_on_the_inputs_declared(case: Case) -> None:
    """In the middle of a run: of each input, by every output that declares it and by no other."""
    kernel, rng = case.module.kernel(), np.random.default_rng(8)
    seen = set()
    for _ in range(60):
        kernel.initialize(values_of(case.module, rng))
        kernel.initial(inputs(kernel, rng))
        for k in range(3):
            u = inputs(kernel, rng)
            if k < 2:
                kernel.step(k * H, H, u)
        saved = kernel.get_state()
        base = kernel.step(2 * H, H, u)
        for port in kernel.inputs:
            for change in (0.1, 5.0):
                kernel.set_state(saved)
                other = kernel.step(2 * H, H, {**u, port.name: u[port.name] + change})
                seen |= {(y, port.name) for y in base if not np.array_equal(base[y], other[y])}
    declared = {(v.name, name) for v in case.module.model().variables for name in v.depends}
    declared -= {("q_d", "q")}  # at the start only
    assert seen == declared


def trajectory(case: Case) -> bytes:
    """Every output of a thousand random steps of the kernel."""
    rng, kernel = np.random.default_rng(4), case.module.kernel()
    kernel.initialize(values_of(case.module, rng))
    kernel.initial(inputs(kernel, rng))
    rows = [kernel.step(k * H, H, inputs(kernel, rng)) for k in range(1000)]
    return b"".join(np.array(value).tobytes() for row in rows for value in row.values())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tdpa_admittance", "nuno_adaptive"])
def test_another_compiler_makes_the_same_numbers(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one with a square root, and the one with the most arithmetic."""
    case = next(case for case in CASES if str(case) == name)
    here = trajectory(case)
    monkeypatch.setattr(toolchain, "host_compiler", lambda: None)
    (binary,) = compile_model(case.module.model()).values()
    library = tmp_path / name
    library.write_bytes(binary)
    monkeypatch.setattr("fmus.build.kernel.library", lambda _: library)
    assert trajectory(case) == here


@pytest.mark.parametrize("case", CASES, ids=str)
def test_presets_are_values_of_the_model(case: Case) -> None:
    presets = vars(case.module).get("PRESETS", {})
    for preset in presets.values():
        kernel = case.module.kernel()
        parameters = {p.name: p for p in kernel.parameters}
        kernel.initialize(
            {name: np.full(parameters[name].shape, value) for name, value in preset.items()}
        )
    defaults = {p.name: p.default for p in case.module.kernel().parameters}
    assert not presets or any(
        all(set(defaults[name]) == {value} for name, value in preset.items())
        for preset in presets.values()
    )
