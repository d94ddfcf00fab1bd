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

from fmus.model import Model, Terminal
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
    signal,
    torque,
)
from fmus.models.static_feedback import Feedback, adaptive
from fmus.numeric import Array
from fmus.reference import Values, derive

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
        kind="sampled",
        variables=(
            Q,
            DQ,
            Q_J,
            DQ_J,
            torque(_ALL, ("theta_hat", "K", "B", "lambda", "tau_max"), elementwise=False),
            signal(
                "epsilon",
                RATE,
                "Synchronising signal: dq + lambda e",
                ("q", "dq", "q_j"),
                ("lambda",),
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


def feedback(x: Values, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Feedback:
    """The equations above."""
    e, de = q - q_j, dq - dq_j
    epsilon = dq + x["lambda"] * e
    return Feedback(epsilon, -x["lambda"] * e, -x["lambda"] * de, -x["K"] * epsilon - x["B"] * de)


fmu, kernel, NunoAdaptive = derive(model, *adaptive("epsilon", feedback))
