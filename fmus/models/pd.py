"""Plain PD: a spring and a damper to where the other arm was.

Of each joint, with the other arm's motion as it is received (delayed)::

    tau = -K_p (q - q_j) - K_d (dq - dq_j)

Condition: none that holds with delay. Without delay any K_p, K_d > 0 synchronise; the delayed
spring and damper create energy, and nothing here takes it away. The law is the position-position
coupling of most leader-follower rigs, and the uncompensated case that Lee and Spong (2006) and
Nuño, Basañez and Ortega (2011) start from.

By its parameters also two controls of a comparison: K_p = K_d = 0 lets both arms be (zero force),
and gains on one side only make that side copy the other (unilateral). Wired to a target that moves
(``minimum_jerk``) instead of another arm it is an operator's arm.

Sampled: read at t_k, held to the next step. Each joint's torque is limited to ±tau_max.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal
from fmus.models.arm import DAMPING, DQ, DQ_J, Q_J, STIFFNESS, TAU_MAX, Q, gain, torque
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

#: The side-by-side comparison's gains; ``free`` is the control without coupling.
PRESETS: dict[str, dict[str, float]] = {
    "PD(10,4)": {"K_p": 10.0, "K_d": 4.0},
    "PD(50,10)": {"K_p": 50.0, "K_d": 10.0},
    "free": {"K_p": 0.0, "K_d": 0.0},
}

#: What one side sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("plant.q", "control.q_j"), ("plant.dq", "control.dq_j"))


def model() -> Model:
    """Declare the controller; the defaults are ``PD(10,4)``."""
    return Model(
        identifier="pd",
        description="Plain PD coupling with another arm",
        kind=_KIND,
        variables=(
            Q,
            DQ,
            Q_J,
            DQ_J,
            torque(("q", "dq", "q_j", "dq_j"), ("K_p", "K_d", "tau_max")),
            gain("K_p", STIFFNESS, 10.0, "Stiffness of the coupling"),
            gain("K_d", DAMPING, 4.0, "Damping of the coupling"),
            TAU_MAX,
        ),
        sources=("pd.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("q_j", "dq_j"), "Motion of the other arm"),
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
class PD:
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
        q, dq, q_j, dq_j = inputs  # each (2,)
        x = self._x
        wanted = -x["K_p"] * (q - q_j) - x["K_d"] * (dq - dq_j)
        return given({"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])})

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
