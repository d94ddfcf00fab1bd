"""Adaptive synchronisation of positions, for unknown inertia and a constant delay.

With the other arm's motion as it is received (delayed)::

    e          = q - q_j,   de = dq - dq_j
    epsilon    = dq + lambda e
    tau        = Y(q, dq, -lambda e, -lambda de) theta_hat - K epsilon - B de
    dtheta_hat = -Gamma Y' epsilon

with the regressor Y of ``dynamics``. Condition: lambda, K, B, Gamma > 0 and a constant delay
(which may be unknown and different each way); the free arms then synchronise whatever the delay
is. With a delay that varies, dq_j is no longer the derivative of q_j.

Source: E. Nuño, R. Ortega, L. Basañez, "An adaptive controller for nonlinear teleoperators",
Automatica 46(1), 2010.

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
    DQ_J,
    GAMMA,
    Q_J,
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
    "Nuno": {"K": 16.0, "B": 4.0, "Gamma": 1.0, "lambda": 1.0},
}

#: What one side sends and where the other takes it: (source, target), see ``bilateral``.
EXCHANGE = (("plant.q", "control.q_j"), ("plant.dq", "control.dq_j"))

_ALL = ("q", "dq", "q_j", "dq_j")


def model() -> Model:
    """Declare the controller; the defaults are ``Nuno``."""
    return Model(
        identifier="nuno_adaptive",
        description="Adaptive synchronisation of positions with another arm",
        kind=_KIND,
        variables=(
            Q,
            DQ,
            Q_J,
            DQ_J,
            torque(_ALL, ("theta_hat", "K", "B", "lambda", "tau_max"), elementwise=False),
            Variable(
                "epsilon",
                "output",
                (2,),
                RATE,
                description="Synchronising signal: dq + lambda e",
                depends=("q", "dq", "q_j"),
                elementwise=True,
                start_depends=("lambda",),
            ),
            THETA_HAT,
            THETA_HAT_NEXT,
            gain("K", DAMPING, 16.0, "Feedback gain of epsilon"),
            gain("B", DAMPING, 4.0, "Damping of the coupling"),
            GAMMA,
            rate("lambda", 1.0, "Gain of the position error in epsilon"),
            TAU_MAX,
        ),
        sources=("nuno_adaptive.c", "trig.c", "static_feedback.h", "regressor.h", "limit.h"),
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
class NunoAdaptive:
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
        q, dq, q_j, dq_j = inputs  # each (2,)
        x = self._x
        e, de = q - q_j, dq - dq_j
        epsilon = dq + x["lambda"] * e
        Y = regressor(q, dq, -x["lambda"] * e, -x["lambda"] * de)
        wanted = Y @ theta_hat - x["K"] * epsilon - x["B"] * de
        tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
        outputs = {"tau": tau, "epsilon": epsilon, "theta_hat": theta_hat}
        if (tau != wanted).any():
            return outputs, theta_hat
        return outputs, theta_hat - h * x["Gamma"] * (Y.T @ epsilon)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
