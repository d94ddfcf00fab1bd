"""The signal on the link, computed next to the robot.

Equation (47) of the paper, of each joint::

    xi = dq + alpha q

Sampled: read at t_k, held to the next step. ``teleoperation`` gives the same signal; taken from
here instead, two controllers may exchange it without delay and without a loop between them,
since this component depends on the robot only. `alpha` must be the controller's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"


def model() -> Model:
    """Declare the signal; the default of alpha is Sec. VII-C's."""
    return Model(
        identifier="xi",
        description="Signal xi = dq + alpha q exchanged by the controllers",
        kind=_KIND,
        variables=(
            Variable("q", "input", (2,), "rad", description="Joint position"),
            Variable("dq", "input", (2,), "rad/s", description="Joint velocity"),
            Variable(
                "xi",
                "output",
                (2,),
                "rad/s",
                description="Signal sent: dq + alpha q",
                depends=("q", "dq"),
                elementwise=True,
                start_depends=("alpha",),
            ),
            Variable("alpha", "parameter", (), "1/s", 0.5, "Gain of q", minimum=0.0),
        ),
        sources=("xi.c",),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "xi"), "Motion in, signal out"),),
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
class Xi:
    """The signal in NumPy: the readable reference of the C kernel."""

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
        """Outputs at the start."""
        return self._law(received(self.inputs, u))

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h."""
        return self._law(received(self.inputs, u, t))

    def _law(self, inputs: list[Array]) -> Outputs:
        q, dq = inputs
        return given({"xi": dq + self._x["alpha"] * q})

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
