"""PD with dissipation: a spring and a damper to where the other arm was, and damping for the delay.

Of each joint, with the other arm's motion as it is received (delayed)::

    tau = -K_v (dq - dq_j) - (K_d + P_eps) dq - K_p (q - q_j)

Condition, for a constant delay of at most T_rt there and back::

    K_d >= (T_rt / 2) K_p,   P_eps > 0

Then the coupling and the links are passive together, whatever the surroundings: K_d pays for the
delayed spring, the first term for itself, and P_eps is what is left over.

Source: D. Lee, M. W. Spong, "Passive bilateral teleoperation with constant time delay", IEEE
Trans. Robotics 22(2), 2006.

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

#: Meets the condition up to T_rt = 2.4 s.
PRESETS: dict[str, dict[str, float]] = {
    "Lee-Spong": {"K_v": 4.0, "K_d": 12.0, "P_eps": 0.1, "K_p": 10.0},
}

#: What one side sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("plant.q", "control.q_j"), ("plant.dq", "control.dq_j"))


def model() -> Model:
    """Declare the controller; the defaults are ``Lee-Spong``."""
    return Model(
        identifier="lee_spong",
        description="PD coupling with another arm, and dissipation for the delay",
        kind=_KIND,
        variables=(
            Q,
            DQ,
            Q_J,
            DQ_J,
            torque(("q", "dq", "q_j", "dq_j"), ("K_v", "K_d", "P_eps", "K_p", "tau_max")),
            gain("K_v", DAMPING, 4.0, "Damping of the coupling"),
            gain("K_d", DAMPING, 12.0, "Damping to the ground, for the delayed spring"),
            gain("P_eps", DAMPING, 0.1, "Damping to the ground beyond that"),
            gain("K_p", STIFFNESS, 10.0, "Stiffness of the coupling"),
            TAU_MAX,
        ),
        sources=("lee_spong.c", "limit.h"),
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
class LeeSpong:
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
        coupling = -x["K_v"] * (dq - dq_j) - x["K_p"] * (q - q_j)
        wanted = coupling - (x["K_d"] + x["P_eps"]) * dq
        return given({"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])})

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
