"""A constant push, as a torque on an arm and as a force on a point mass::

    tau_h = tau_p,   f = f_p    for t_0 <= t < t_1
    tau_h = 0,       f = 0      otherwise

The input of the closed forms: an arm under the paper's law drifts at lambda_M tau_p / (K alpha), a
pair of them at lambda_M tau_p / (K alpha (2 + lambda (T_12 + T_21))).

Sampled: the push of t_k holds to the next step; a step that begins less than a millionth of its
length before t_0 or t_1 counts as beginning then. Outputs at the start are those of t = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import TORQUE
from fmus.models.start import copied, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

_NEVER = 1e9  # s


def model() -> Model:
    """Declare the push; by default 1 N.m on each joint, and 1 N, for ever."""
    return Model(
        identifier="push",
        description="Constant push for a time",
        kind=_KIND,
        variables=(
            Variable(
                "tau_h",
                "output",
                (2,),
                TORQUE,
                description="Torque on an arm",
                elementwise=True,
                start_depends=("tau_p", "t_0"),
            ),
            Variable(
                "f",
                "output",
                (),
                "N",
                description="Force on a point mass",
                start_depends=("f_p", "t_0"),
            ),
            Variable("tau_p", "parameter", (2,), TORQUE, 1.0, "Torque while it pushes"),
            Variable("f_p", "parameter", (), "N", 1.0, "Force while it pushes"),
            Variable("t_0", "parameter", (), "s", 0.0, "When it begins", minimum=0.0),
            Variable("t_1", "parameter", (), "s", _NEVER, "When it ends", minimum=1e-9),
        ),
        sources=("push.c", "schedule.h"),
        step=5e-3,
        terminals=(Terminal("push", ("tau_h", "f"), "Torque and force"),),
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
class Push:
    """The push in NumPy: the readable reference of the C kernel."""

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
        return self._at(0.0, 0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h."""
        return self._at(t, h)

    def _at(self, t: float, h: float) -> Outputs:
        x, now = self._x, t + 1e-6 * h
        on = float(x["t_0"] <= now < x["t_1"])
        return {"tau_h": on * x["tau_p"], "f": on * x["f_p"]}

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
