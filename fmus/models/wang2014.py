"""Adaptive consensus with static feedback, for unknown inertia and a constant delay.

With the motion q_j, dq_j of the other arm, or of several neighbours, as received (delayed)::

    z          = -lambda Σ_j (q - q_j),   dz = -lambda Σ_j (dq - dq_j)
    s          = dq - z
    tau        = -K s + Y(q, dq, z, dz) theta_hat
    dtheta_hat = -Gamma Y' s

with the regressor Y of ``dynamics``; `lambda` is the weight w_ij of every edge. The reference z
is a static function of the measured and received signals, whereas the z of ``teleoperation`` is the
state of a dynamic feedback. A displaced arm therefore pulls at the hand as long as it is displaced.
Condition: lambda, K, Gamma > 0 and a constant delay of any size (for a network: a directed spanning
tree). The law equals ``nuno_adaptive`` with B = 0.

Source: H. Wang, "Consensus of networked mechanical systems with communication delays: a unified
framework", IEEE Trans. Automatic Control 59(6), 2014.

Sampled: outputs as of t_k; theta_hat advances by the explicit Euler method. Each joint's torque is
limited to ±tau_max; while any joint is at its limit theta_hat is not updated (anti-windup).
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, rate
from fmus.arms.static_feedback import Feedback, LawSize, adaptive, disagreement
from fmus.build.reference import Values, derive
from fmus.model import Model
from fmus.model.numeric import Array

PRESETS: dict[str, dict[str, float]] = {
    "Wang": {"K": 16.0, "Gamma": 1.0, "lambda": 1.0},
}

_ALL = ("q", "dq", "q_j", "dq_j")


def model(neighbours: int = 1) -> Model:
    """Declare the controller for `neighbours` >= 1; the defaults are ``Wang``. Raises FmuError."""
    return declare(LawSize(neighbours), __doc__)


def declare(size: LawSize, documentation: str | None) -> Model:
    """The controller of an arm of this `size`."""
    return size.controller(
        "wang2014",
        "Adaptive consensus with another arm by static feedback",
        (
            size.received("q_j", "rad", "Received joint position"),
            size.received("dq_j", RATE, "Received joint velocity"),
            size.arm.torque(_ALL, ("theta_hat", "K", "lambda", "tau_max"), elementwise=False),
            size.arm.signal("s", RATE, "Sliding vector: dq - z", ("q", "dq", "q_j"), ("lambda",)),
        ),
        (size.arm.gain("K", DAMPING, 16.0, "Feedback gain of s"),),
        (rate("lambda", 1.0, "Coupling gain: the weight of an edge"),),
        documentation,
    )


def feedback(x: Values, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Feedback:
    """The equations above: `q`, `dq` (m,) rad, rad/s; `q_j`, `dq_j` (m,) or (n, m), as received."""
    z, dz = -x["lambda"] * disagreement(q, q_j), -x["lambda"] * disagreement(dq, dq_j)
    s = dq - z
    return Feedback(s, z, dz, -x["K"] * s)


fmu, kernel, Wang2014 = derive(model, *adaptive("s", feedback))
