"""P+d: a spring to where the other arm was, a damper to the ground.

Of each joint, with the other arm's position as it is received (delayed)::

    tau = -K (q - q_j) - B dq

Condition, for arms l and r and delays of at most T_l, T_r, which may vary::

    4 B_l B_r > (T_l + T_r)^2 K_l K_r

Then velocities and position error stay bounded, and with passive surroundings the free arms
synchronise. It follows from V = sum over the arms of dq' M dq / (2 K_i), plus |q_l - q_r|^2 / 2:
what the delayed spring adds to dV/dt is at most what the dampers take away.

Source: E. Nuño, R. Ortega, N. Barabanov, L. Basañez, "A globally stable PD controller for
bilateral teleoperators", IEEE Trans. Robotics 24(3), 2008; E. Nuño, L. Basañez, R. Ortega,
M. Spong, "Position tracking for non-linear teleoperators with variable time delay", Int. J.
Robotics Research 28(7), 2009.

Sampled: read at t_k, held to the next step. Each joint's torque is limited to ±tau_max.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal
from fmus.models.arm import DAMPING, DQ, Q_J, STIFFNESS, TAU_MAX, Q, gain, torque
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

#: ``P+d`` meets the condition up to T_l + T_r = 2.5 s, ``P+d violating`` up to 0.6 s.
PRESETS: dict[str, dict[str, float]] = {
    "P+d": {"K": 10.0, "B": 12.5},
    "P+d violating": {"K": 10.0, "B": 3.0},
}

#: What one side sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("plant.q", "control.q_j"),)


def model() -> Model:
    """Declare the controller; the defaults are ``P+d``."""
    return Model(
        identifier="p_d",
        description="Spring to another arm and damper to the ground (P+d)",
        kind=_KIND,
        variables=(
            Q,
            DQ,
            Q_J,
            torque(("q", "dq", "q_j"), ("K", "B", "tau_max")),
            gain("K", STIFFNESS, 10.0, "Stiffness of the coupling"),
            gain("B", DAMPING, 12.5, "Damping to the ground"),
            TAU_MAX,
        ),
        sources=("p_d.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("q_j",), "Position of the other arm"),
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
class PPlusD:
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
        q, dq, q_j = inputs  # each (2,)
        x = self._x
        wanted = -x["K"] * (q - q_j) - x["B"] * dq
        return given({"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])})

    def get_state(self) -> object:
        """Parameters, copied; there is no other state."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
