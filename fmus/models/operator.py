"""Operator: a hand that holds the robot with a spring and a damper.

The standard PD action of the paper's Sec. VII, torque on the robot, of each joint::

    tau_h = -k_d dq - k_p (q - q_h)

Sampled: read at t_k, held to the next step. The same law is inside ``planar2r``, solved at the rate
of its integrator, for grips too stiff for the communication step.
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
    """Declare the operator; the defaults are Sec. VII: k_p 10, k_d 5, q_h (3.5, 3)."""
    torque, stiffness, damping = "N.m", "N.m/rad", "N.m.s/rad"
    return Model(
        identifier="operator",
        description="Operator holding the robot with a spring and a damper",
        kind=_KIND,
        variables=(
            Variable("q", "input", (2,), "rad", description="Joint position"),
            Variable("dq", "input", (2,), "rad/s", description="Joint velocity"),
            Variable(
                "tau_h",
                "output",
                (2,),
                torque,
                description="Torque of the operator on the robot",
                depends=("q", "dq"),
                elementwise=True,
                start_depends=("k_p", "k_d", "q_h"),
            ),
            Variable("k_p", "parameter", (2,), stiffness, 10.0, "Stiffness", minimum=0.0),
            Variable("k_d", "parameter", (2,), damping, 5.0, "Damping", minimum=0.0),
            Variable("q_h", "parameter", (2,), "rad", (3.5, 3.0), "Position the operator wants"),
        ),
        sources=("operator.c",),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau_h"), "Motion in, torque out"),),
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
class Operator:
    """The operator in NumPy: the readable reference of the C kernel."""

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
        return given({"tau_h": -self._x["k_d"] * dq - self._x["k_p"] * (q - self._x["q_h"])})

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
