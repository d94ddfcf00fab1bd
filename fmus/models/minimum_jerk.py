"""A target that a hand wants to follow: from one place to another with the least jerk.

For the joints q_h from q_0 to q_f, and for the endpoint x_h from x_0 to x_f likewise::

    q_h  = q_0 + (q_f - q_0) (10 p³ - 15 p⁴ + 6 p⁵)      p = (t - t_0) / T, from 0 to 1
    dq_h = (q_f - q_0) 30 p² (1 - p)² / T

The path of fifth order that starts and ends at rest, without acceleration, and has the least
∫ |d³q/dt³|² dt of all such. A target does nothing by itself: wired to ``pd`` (as q_j, dq_j), to the
grip inside ``planar2r`` (as q_h) or to ``endpoint_operator`` it moves the arm.

Source: T. Flash, N. Hogan, "The coordination of arm movements: an experimentally confirmed
mathematical model", J. Neuroscience 5(7), 1985.

Sampled: the target of t_k holds to the next step. Outputs at the start are those of t = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import RATE
from fmus.models.start import copied, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"


def _output(name: str, unit: str, description: str, start: tuple[str, ...] = ()) -> Variable:
    return Variable(
        name,
        "output",
        (2,),
        unit,
        description=description,
        elementwise=True,
        start_depends=start,
    )


def model() -> Model:
    """Declare the target; by default from 0 to Sec. VII's q_h within 5 s from t = 0."""
    return Model(
        identifier="minimum_jerk",
        description="Target that moves with the least jerk",
        kind=_KIND,
        variables=(
            _output("q_h", "rad", "Joint position wanted", ("q_0",)),
            _output("dq_h", RATE, "Joint velocity wanted"),
            _output("x_h", "m", "Endpoint wanted", ("x_0",)),
            _output("dx_h", "m/s", "Velocity of the endpoint wanted"),
            Variable("q_0", "parameter", (2,), "rad", 0.0, "Joint position before"),
            Variable("q_f", "parameter", (2,), "rad", (3.5, 3.0), "Joint position after"),
            Variable("x_0", "parameter", (2,), "m", (2.0, 0.0), "Endpoint before"),
            Variable("x_f", "parameter", (2,), "m", (0.0, 1.0), "Endpoint after"),
            Variable("t_0", "parameter", (), "s", 0.0, "When it begins", minimum=0.0),
            Variable("T", "parameter", (), "s", 5.0, "How long it takes", minimum=1e-6),
        ),
        sources=("minimum_jerk.c",),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q_h", "dq_h"), "Target of the joints"),
            Terminal("endpoint", ("x_h", "dx_h"), "Target of the endpoint"),
        ),
        documentation=__doc__ or "",
    )


def fmu(version: Version = "2.0") -> Path:
    """Path of the FMU, built at installation or now into the cache; `version` of FMI.

    Raises FmuError where it cannot be built.
    """
    from fmus.build import find

    return find(model(), version)


def kernel() -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
    from fmus.kernel import Kernel

    return Kernel(model())


@final
class MinimumJerk:
    """The target in NumPy: the readable reference of the C kernel."""

    kind: Kind = "sampled"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self._x = start_values(self._model, {})

    def initialize(self, values: Values) -> None:
        """Take the parameters. Raises ScenarioError."""
        self._x = start_values(self._model, values)

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start: those of t = 0."""
        return self._at(0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h."""
        return self._at(t)

    def _at(self, t: float) -> Outputs:
        x = self._x
        p = np.clip((t - x["t_0"]) / x["T"], 0.0, 1.0)
        part, speed = 10 * p**3 - 15 * p**4 + 6 * p**5, 30 * p**2 * (1 - p) ** 2 / x["T"]
        way_q, way_x = x["q_f"] - x["q_0"], x["x_f"] - x["x_0"]
        return {
            "q_h": x["q_0"] + way_q * part,
            "dq_h": way_q * speed,
            "x_h": x["x_0"] + way_x * part,
            "dx_h": way_x * speed,
        }

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
