"""Adaptive synchronisation of positions, for unknown inertia and a constant delay.

With the motion q_j, dq_j of the other arm, or of n neighbours, as received (delayed)::

    e          = (1/n) Σ_j (q - q_j),   de = (1/n) Σ_j (dq - dq_j)
    epsilon    = dq + lambda e
    tau        = Y(q, dq, -lambda e, -lambda de) theta_hat - K epsilon - B de
    dtheta_hat = -Gamma Y' epsilon

with the regressor Y of ``dynamics``. Condition: lambda, K, B, Gamma > 0 and a constant delay
(which may be unknown and different in each direction); the free arms then synchronise for any
delay. If the delay varies, dq_j is not the derivative of q_j.

Source: E. Nuño, R. Ortega, L. Basañez, "An adaptive controller for nonlinear teleoperators",
Automatica 46(1), 2010; for networks, from memory, E. Nuño, R. Ortega, L. Basañez, D. Hill,
"Synchronization of networks of nonidentical Euler-Lagrange systems with uncertain parameters and
communication delays", IEEE Trans. Automatic Control 56(4), 2011, which has no B.

Sampled: outputs as of t_k; theta_hat advances by the explicit Euler method. Each joint's torque is
limited to ±tau_max; while any joint is at its limit theta_hat is not updated (anti-windup).
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, rate
from fmus.arms.static_feedback import Feedback, LawSize, adaptive, mean_disagreement
from fmus.build.reference import Values, derive
from fmus.model import Model
from fmus.model.numeric import Array

PRESETS: dict[str, dict[str, float]] = {
    "Nuno": {"K": 16.0, "B": 4.0, "Gamma": 1.0, "lambda": 1.0},
}

_ALL = ("q", "dq", "q_j", "dq_j")


def model(neighbours: int = 1) -> Model:
    """Declare the controller for `neighbours` >= 1; the defaults are ``Nuno``; raises FmuError."""
    return declare(LawSize(neighbours), __doc__)


def declare(size: LawSize, documentation: str | None) -> Model:
    """The controller of an arm of this `size`."""
    return size.controller(
        "nuno_adaptive",
        "Adaptive synchronisation of positions with another arm",
        (
            size.received("q_j", "rad", "Received joint position"),
            size.received("dq_j", RATE, "Received joint velocity"),
            size.arm.torque(_ALL, ("theta_hat", "K", "B", "lambda", "tau_max"), elementwise=False),
            size.arm.signal(
                "epsilon",
                RATE,
                "Synchronising signal: dq + lambda e",
                ("q", "dq", "q_j"),
                ("lambda",),
            ),
        ),
        (
            size.arm.gain("K", DAMPING, 16.0, "Feedback gain of epsilon"),
            size.arm.gain("B", DAMPING, 4.0, "Damping of the coupling"),
        ),
        (rate("lambda", 1.0, "Gain of the position error in epsilon"),),
        documentation,
    )


def feedback(x: Values, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Feedback:
    """The equations above: `q`, `dq` (m,) rad, rad/s; `q_j`, `dq_j` (m,) or (n, m), as received."""
    e, de = mean_disagreement(q, q_j), mean_disagreement(dq, dq_j)
    epsilon = dq + x["lambda"] * e
    return Feedback(epsilon, -x["lambda"] * e, -x["lambda"] * de, -x["K"] * epsilon - x["B"] * de)


fmu, kernel, NunoAdaptive = derive(model, *adaptive("epsilon", feedback))
