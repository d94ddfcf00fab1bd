"""Damping with gravity compensation: the simplest controller an arm can be led by.

Equation (24) of the paper, Theorem 1; the paper calls the damping alpha, which is a rate in 1/s
everywhere else::

    tau = -d dq + g(q)

    g = [ γ1 cos q1 + γ2 cos (q1 + q2) ]     theta_g = (γ1, γ2), N.m, as the platform knows it
        [ γ2 cos (q1 + q2)             ]

Where g is the arm's own gravity, M ddq + C dq = -d dq + tau_h: a constant push on an arm that need
not turn ends in the velocity tau_h / d, and the L2 norm of dq is at most that of tau_h divided by
the least d. From tau_h to q there is one pure integral more: infinitely manipulable, degree one.

Sampled: read at t_k, held to the next step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.dynamics import gravity
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"


def model() -> Model:
    """Declare the controller; by default d is 5 N.m.s/rad and the arm horizontal."""
    torque, damping = "N.m", "N.m.s/rad"
    return Model(
        identifier="damping",
        description="Damping with gravity compensation",
        kind=_KIND,
        variables=(
            Variable("q", "input", (2,), "rad", description="Joint position"),
            Variable("dq", "input", (2,), "rad/s", description="Joint velocity"),
            Variable(
                "tau",
                "output",
                (2,),
                torque,
                description="Control torque",
                depends=("q", "dq"),
                start_depends=("d", "theta_g"),
            ),
            Variable("d", "parameter", (2,), damping, 5.0, "Damping of each joint", minimum=0.0),
            Variable("theta_g", "parameter", (2,), torque, 0.0, "Known gravity parameters"),
        ),
        sources=("damping.c", "trig.c"),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),),
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
class Damping:
    """The controller in NumPy: the readable reference of the C kernel."""

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
        return given({"tau": -self._x["d"] * dq + gravity(self._x["theta_g"], q)})

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
