"""Driven Van der Pol oscillator, one input and one output, one explicit Euler step a step.

::

    dx/dt = v
    dv/dt = mu (1 - x^2) v - omega^2 x + gain u

The reference object rounds as the C kernel does: same operations, same order.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, final

from cosim.base.component import Kind, Parameter, Port
from fmus.build.archive import Version, find
from fmus.build.kernel import Kernel
from fmus.model import Model, Variable
from fmus.model.numeric import checked_outputs, copy_state, received, start_values

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values


def model() -> Model:
    """Declare the oscillator."""
    return Model(
        identifier="bench_vdp",
        description="Driven Van der Pol oscillator",
        kind="continuous",
        variables=(
            Variable("u", "input", (), "1", description="Drive"),
            Variable("x", "output", (), "1", 2.0, "Position", settable=True),
            Variable("v", "local", (), "1/s", 0.0, "Velocity", settable=True),
            Variable("mu", "parameter", (), "1/s", 1.0, "Damping"),
            Variable("omega2", "parameter", (), "1/s2", 1.0, "Stiffness omega^2", minimum=0.0),
            Variable("gain", "parameter", (), "1/s2", 0.1, "Gain of the drive"),
        ),
        sources=(str(Path(__file__).with_name("vdp.c")),),
        step=1e-2,
        documentation=__doc__ or "",
    )


@lru_cache(maxsize=2)
def fmu(version: Version = "2.0") -> Path:
    """Path of the FMU, built into the cache if it is not there."""
    return find(model(), version)


def kernel() -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between."""
    return Kernel(model())


@final
class VanDerPol:
    """The oscillator in NumPy."""

    kind: Kind = "continuous"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self._x = start_values(self._model, {})

    def initialize(self, values: Values) -> None:
        """Take parameters and start values. Raises ScenarioError."""
        self._x = start_values(self._model, values)

    def initial(self, u: Values) -> Outputs:
        """The position at the start, whatever the drive."""
        del u
        return {"x": self._x["x"].copy()}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """One Euler step of length h (s)."""
        (drive,) = received(self.inputs, u, t)
        s = self._x
        x, v = s["x"], s["v"]
        a = s["mu"] * (1.0 - x * x) * v - s["omega2"] * x + s["gain"] * drive
        s["x"], s["v"] = x + h * v, v + h * a
        return checked_outputs({"x": s["x"]}, t)

    def get_state(self) -> object:
        """All values, copied."""
        return copy_state(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copy_state(state)
