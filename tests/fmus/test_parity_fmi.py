"""The C kernel called directly and through FMI 2.0 and 3.0: equal to the bit.

The FMUs are driven by FMPy, which shares no code with this project.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from cosim.base.component import Component, Parameter, Port
from fmus.models import adaptive, damping, operator, planar2r, pointmass, teleoperation, xi

Version = Literal["2.0", "3.0"]
Values = dict[str, np.ndarray]
H, STEPS = 5e-3, 300

START = {
    "planar2r": {
        "q": np.array([-1.0, 0.5]),
        "k_p": np.array([10.0, 5.0]),
        "k_d": np.array([5.0, 4.0]),
        "theta_g": np.array([24.525, 11.772]),
        "contact": np.array(2.0),
        "k_w": np.full(2, 200.0),
        "q_w": np.full(2, 1.0),
        "substeps": np.array(3.0),
    },
    "teleoperation": {"Gamma": np.array([1.0, 0.5, 0.1]), "tau_max": np.full(2, 60.0)},
    "teleoperation_n2": {"z": np.array([0.5, -0.5]), "theta_hat": np.array([3.0, 1.0, 1.0])},
    "teleoperation_gravity": {"gravity": np.array(2.0), "theta_hat": np.full(5, 1.0)},
    "adaptive": {"lambda_c": np.array(4.0), "theta_hat": np.array([3.0, 1.0, 1.0])},
    "damping": {"d": np.array([3.0, 7.0]), "theta_g": np.array([24.525, 11.772])},
    "pointmass": {"x": np.array(0.25), "m": np.array(2.5), "b": np.array(0.7)},
    "operator": {"k_p": np.array([12.0, 7.0])},
    "xi": {"alpha": np.array(1.7)},
}
MODELS = [
    (planar2r, {}),
    (teleoperation, {}),
    (teleoperation, {"neighbours": 2}),
    (teleoperation, {"gravity": 1}),
    (adaptive, {}),
    (damping, {}),
    (pointmass, {}),
    (operator, {}),
    (xi, {}),
]


def references(version: Version, numbers: dict[str, int], port: Port | Parameter) -> list[int]:
    """Value references of a variable: one in FMI 3.0, one for each scalar in FMI 2.0."""
    if version == "3.0" or port.shape == ():
        return [numbers[port.name]]
    return [
        numbers[f"{port.name}[{','.join(map(str, index))}]"] for index in np.ndindex(port.shape)
    ]


class Slave:
    """An FMU behind FMPy's interface, with the ports of `like`."""

    def __init__(self, path: Path, folder: Path, like: Component) -> None:
        description = read_model_description(path)
        self.version: Version = "3.0" if description.fmiVersion == "3.0" else "2.0"
        make = FMU3Slave if self.version == "3.0" else FMU2Slave
        self.fmu = make(
            guid=description.guid,
            unzipDirectory=extract(path, folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.fmu.instantiate()
        self.like = like
        numbers = {v.name: v.valueReference for v in description.modelVariables}
        self.numbers = {
            port.name: references(self.version, numbers, port)
            for port in (*like.inputs, *like.outputs, *like.parameters)
        }

    def set(self, port: Port | Parameter, value: np.ndarray) -> None:
        flat, numbers = np.ravel(value).tolist(), self.numbers[port.name]
        if isinstance(port, Parameter) and port.type == "integer":
            put = self.fmu.setInt32 if self.version == "3.0" else self.fmu.setInteger
            put(numbers, [int(x) for x in flat])
            return
        put = self.fmu.setFloat64 if self.version == "3.0" else self.fmu.setReal
        put(numbers, flat)

    def outputs(self) -> Values:
        if self.version == "3.0":
            flat = {p: self.fmu.getFloat64(self.numbers[p.name], p.size) for p in self.like.outputs}
        else:
            flat = {p: self.fmu.getReal(self.numbers[p.name]) for p in self.like.outputs}
        return {port.name: np.reshape(values, port.shape) for port, values in flat.items()}

    def start(self, values: Values, u: Values) -> Values:
        """Outputs at the start, still in Initialization Mode; then leave it."""
        if self.version == "3.0":
            self.fmu.enterInitializationMode(startTime=0.0)
        else:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        for parameter in self.like.parameters:
            if parameter.name in values:
                self.set(parameter, values[parameter.name])
        self.feed(u)
        y = self.outputs()
        self.fmu.exitInitializationMode()
        return y

    def feed(self, u: Values) -> None:
        for port in self.like.inputs:
            self.set(port, u[port.name])

    def step(self, k: int, u: Values) -> Values:
        self.feed(u)
        self.fmu.doStep(currentCommunicationPoint=k * H, communicationStepSize=H)
        return self.outputs()

    def bytes(self) -> bytes:
        """The state, serialised."""
        state = self.fmu.getFMUState()
        blob: bytes = self.fmu.serializeFMUState(state)
        self.fmu.freeFMUState(state)
        return blob

    def restore(self, blob: bytes) -> None:
        state = self.fmu.deserializeFMUState(blob)
        self.fmu.setFMUState(state)
        self.fmu.freeFMUState(state)


Pair = tuple[Component, Callable[[], Slave]]


@pytest.fixture(params=["2.0", "3.0"])
def version(request: pytest.FixtureRequest) -> Version:
    chosen: Version = request.param
    return chosen


@pytest.fixture(params=MODELS, ids=lambda model: model[0].model(**model[1]).identifier)
def pair(request: pytest.FixtureRequest, version: Version, tmp_path: Path) -> Iterator[Pair]:
    """The kernel of a model, and its FMU's instances, freed at the end."""
    module, sizes = request.param
    kernel: Component = module.kernel(**sizes)
    slaves: list[Slave] = []

    def instance() -> Slave:
        folder = tmp_path / str(len(slaves))
        slaves.append(Slave(module.fmu(version, **sizes), folder, kernel))
        return slaves[-1]

    yield kernel, instance
    for slave in slaves:
        slave.fmu.terminate()
        slave.fmu.freeInstance()


def drawn(component: Component, rng: np.random.Generator) -> Values:
    """Inputs by chance; friction that is added to a mass is not negative."""
    return {
        port.name: rng.uniform(0 if port.name == "b_add" else -3, 3, port.shape)
        for port in component.inputs
    }


def same(a: object, b: Values) -> bool:
    assert isinstance(a, dict)
    return all(np.array(a[name]).tobytes() == b[name].tobytes() for name in b)


def start_of(slave: Slave) -> Values:
    identifier = slave.fmu.modelIdentifier
    return START[identifier]


def test_fmu_and_kernel_are_the_same_to_the_bit(pair: Pair) -> None:
    kernel, instance = pair
    slave, rng = instance(), np.random.default_rng(1)
    values, u = start_of(slave), drawn(kernel, rng)
    kernel.initialize(values)
    assert same(dict(kernel.initial(u)), slave.start(values, u))
    for k in range(STEPS):
        u = drawn(kernel, rng)
        assert same(dict(kernel.step(k * H, H, u)), slave.step(k, u)), k


def test_a_serialised_state_goes_on_in_another_instance(pair: Pair) -> None:
    kernel, instance = pair
    first, second, rng = instance(), instance(), np.random.default_rng(2)
    values, u = start_of(first), drawn(kernel, rng)
    kernel.initialize(values)
    kernel.initial(u)
    first.start(values, u)
    second.start({}, u)
    for k in range(10):
        u = drawn(kernel, rng)
        kernel.step(k * H, H, u)
        first.step(k, u)
    second.restore(first.bytes())
    for k in range(10, 20):
        u = drawn(kernel, rng)
        expected = {name: np.array(y) for name, y in kernel.step(k * H, H, u).items()}
        assert same(expected, first.step(k, u))
        assert same(expected, second.step(k, u))
