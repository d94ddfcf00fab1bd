"""A push that decays so slowly that it can move an arm for ever, as a torque and as a force.

The paper's example (Sec. III) of an input that is square-integrable while its integral is not
bounded, f = 1 / (t + 1)::

    tau_h = tau_0 / (t / T + 1)      on an arm
    f     = f_0 / (t / T + 1)        on a point mass

Its norm is finite, ∫ f² dt = f_0² T, its integral f_0 T ln (t / T + 1) is not: a system whose
output holds the integral of the input goes wherever one likes, at an effort that is bounded.

Sampled: the push of t_k holds to the next step. Outputs at the start are those of t = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

from cosim.component import Kind, Parameter, Port
from cosim.errors import RunError
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import TORQUE
from fmus.models.start import copied, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"


def model() -> Model:
    """Declare the push; by default 1 N.m on each joint, and 1 N, at t = 0, and T = 1 s."""
    return Model(
        identifier="decaying_push",
        description="Push that decays as 1 / (t + 1)",
        kind=_KIND,
        variables=(
            Variable(
                "tau_h",
                "output",
                (2,),
                TORQUE,
                description="Torque on an arm",
                elementwise=True,
                start_depends=("tau_0",),
            ),
            Variable(
                "f",
                "output",
                (),
                "N",
                description="Force on a point mass",
                start_depends=("f_0",),
            ),
            Variable("tau_0", "parameter", (2,), TORQUE, 1.0, "Torque at t = 0"),
            Variable("f_0", "parameter", (), "N", 1.0, "Force at t = 0"),
            Variable("T", "parameter", (), "s", 1.0, "When it is half of that", minimum=1e-6),
        ),
        sources=("decaying_push.c",),
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
class DecayingPush:
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
        return self._at(0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h."""
        return self._at(t)

    def _at(self, t: float) -> Outputs:
        x = self._x
        slow = t / x["T"] + 1.0
        if not slow > 0.0:
            raise RunError(f"the time is {t:g} s, expected more than -T = {-x['T']:g} s", time=t)
        return {"tau_h": x["tau_0"] / slow, "f": x["f_0"] / slow}

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
