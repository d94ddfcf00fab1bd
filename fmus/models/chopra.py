"""Adaptive synchronisation of r = dq + lambda q, for unknown inertia and a constant delay.

Let r_j denote the r of the other arm, or of each neighbour, as received (delayed)::

    r          = dq + lambda q                                                sent
    tau        = Y(q, dq, -lambda q, -lambda dq) theta_hat - K Σ_j (r - r_j)
    dtheta_hat = -Gamma Y' r

with the regressor Y of ``dynamics``. Condition: lambda, K, Gamma > 0 and a constant delay,
of any size; the free arms then synchronise. The law is unsuitable for arms with gravity in Y: the
estimate drives r itself, not a difference, to zero, so that the arms are drawn to q = 0.

Source: N. Chopra, M. W. Spong, R. Lozano, "Synchronization of bilateral teleoperators with time
delay", Automatica 44(8), 2008.

Sampled: outputs as of t_k; theta_hat advances by the explicit Euler method. Each joint's torque is
limited to ±tau_max; while any joint is at its limit theta_hat is not updated (anti-windup).
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, rate
from fmus.arms.static_feedback import Feedback, LawSize, adaptive, disagreement
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array

PRESETS: dict[str, dict[str, float]] = {
    "Chopra": {"K": 16.0, "Gamma": 1.0, "lambda": 0.5},
}


def model(neighbours: int = 1) -> Model:
    """Declare the controller for `neighbours` >= 1; defaults: ``Chopra``. Raises FmuError."""
    return declare(LawSize(neighbours), __doc__)


def declare(size: LawSize, documentation: str | None) -> Model:
    """The controller of an arm of this `size`."""
    return size.controller(
        "chopra",
        "Adaptive synchronisation of velocity and position with another arm",
        (
            size.received("r_j", RATE, "Received r"),
            size.arm.torque(
                ("q", "dq", "r_j"), ("theta_hat", "K", "lambda", "tau_max"), elementwise=False
            ),
            size.arm.signal("r", RATE, "Signal sent: dq + lambda q", ("q", "dq"), ("lambda",)),
        ),
        (size.arm.gain("K", DAMPING, 16.0, "Gain of the coupling"),),
        (rate("lambda", 0.5, "Gain of q in r"),),
        documentation,
        Terminal("network", ("r", "r_j"), "Signals exchanged with the other arm"),
    )


def feedback(x: Values, q: Array, dq: Array, r_j: Array) -> Feedback:
    """The equations above for m joints: `q`, `dq` (m,) rad, rad/s; `r_j` (m,) or (n, m) rad/s."""
    r = dq + x["lambda"] * q
    return Feedback(r, -x["lambda"] * q, -x["lambda"] * dq, -x["K"] * disagreement(r, r_j))


fmu, kernel, Chopra = derive(model, *adaptive("r", feedback))
