"""Adaptive synchronisation of r = dq + lambda q, for unknown inertia and a constant delay.

With r_j the other arm's r as it is received (delayed)::

    r          = dq + lambda q                                                sent
    tau        = Y(q, dq, -lambda q, -lambda dq) theta_hat + K (r_j - r)
    dtheta_hat = -Gamma Y' r

with the regressor Y of ``dynamics``. Condition: lambda, K, Gamma > 0 and a constant delay,
whatever its size; the free arms then synchronise. Not for arms with gravity in Y: since the
estimate drives r itself, not a difference, to zero, the arms are drawn to q = 0.

Source: N. Chopra, M. W. Spong, R. Lozano, "Synchronization of bilateral teleoperators with time
delay", Automatica 44(8), 2008.

Sampled: outputs as of t_k; theta_hat advances by the explicit Euler method. Each joint's torque is
limited to ±tau_max; while any joint is at its limit theta_hat stands still (anti-windup).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model, Terminal, Variable
from fmus.models.arm import (
    DAMPING,
    DQ,
    GAMMA,
    RATE,
    TAU_MAX,
    THETA_HAT,
    THETA_HAT_NEXT,
    Q,
    gain,
    rate,
    torque,
)
from fmus.models.dynamics import regressor
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

_KIND: Kind = "sampled"

PRESETS: dict[str, dict[str, float]] = {
    "Chopra": {"K": 16.0, "Gamma": 1.0, "lambda": 0.5},
}

#: What one side sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("control.r", "control.r_j"),)


def model() -> Model:
    """Declare the controller; the defaults are ``Chopra``."""
    return Model(
        identifier="chopra",
        description="Adaptive synchronisation of velocity and position with another arm",
        kind=_KIND,
        variables=(
            Q,
            DQ,
            Variable("r_j", "input", (2,), RATE, description="Received r"),
            torque(("q", "dq", "r_j"), ("theta_hat", "K", "lambda", "tau_max"), elementwise=False),
            Variable(
                "r",
                "output",
                (2,),
                RATE,
                description="Signal sent: dq + lambda q",
                depends=("q", "dq"),
                elementwise=True,
                start_depends=("lambda",),
            ),
            THETA_HAT,
            THETA_HAT_NEXT,
            gain("K", DAMPING, 16.0, "Gain of the coupling"),
            GAMMA,
            rate("lambda", 0.5, "Gain of q in r"),
            TAU_MAX,
        ),
        sources=("chopra.c", "trig.c", "static_feedback.h", "regressor.h", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("r", "r_j"), "Signals exchanged with the other arm"),
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
class Chopra:
    """The controller in NumPy: the readable reference of the C kernel."""

    kind: Kind = "sampled"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self.initialize({})

    def initialize(self, values: Values) -> None:
        """Go to the start. Raises ScenarioError."""
        self._x = start_values(self._model, values)  # parameters, and the state theta_hat
        self._x["theta_hat_next"] = self._x["theta_hat"]

    def initial(self, u: Values) -> Outputs:
        """Outputs for the start value of theta_hat; it does not advance."""
        outputs, _ = self._law(0.0, received(self.inputs, u), self._x["theta_hat"])
        return given(outputs)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; theta_hat advances to t + h.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        x, inputs = self._x, received(self.inputs, u, t)
        outputs, theta_hat_next = self._law(h, inputs, x["theta_hat_next"])
        given(outputs, t)
        x["theta_hat"], x["theta_hat_next"] = outputs["theta_hat"], theta_hat_next
        return outputs

    def _law(
        self, h: float, inputs: list[Array], theta_hat: Array
    ) -> tuple[dict[str, Array], Array]:
        """Outputs for the estimate theta_hat (3,), and the estimate a time h (s) later."""
        q, dq, r_j = inputs  # each (2,)
        x = self._x
        r = dq + x["lambda"] * q
        Y = regressor(q, dq, -x["lambda"] * q, -x["lambda"] * dq)
        wanted = Y @ theta_hat + x["K"] * (r_j - r)
        tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
        outputs = {"tau": tau, "r": r, "theta_hat": theta_hat}
        if (tau != wanted).any():
            return outputs, theta_hat
        return outputs, theta_hat - h * x["Gamma"] * (Y.T @ r)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
