"""Adaptive consensus whose reference is a filter of second order: no delayed velocity is needed.

With the position of the other arm, or of n neighbours, as it is received (delayed)::

    dz         = -k_d z - (k_p/n) Σ_j (q - q_j)                  the reference velocity is a state
    s          = dq - z
    tau        = -K s + Y(q, dq, z, dz) theta_hat
    dtheta_hat = -Gamma Y' s

with the regressor Y of ``dynamics``. Only positions are sent, and nothing received is
differentiated, so jumps of the delay do no harm to dz.

Condition: K, Gamma, k_p > 0 and k_d² >= 4 k_p; the delay may be any that is bounded, and may jump.
Our own derivation, for n = 1: with p = q + 2 z / k_d and s = 0 the law reads dq = a (p - q) and
dp = (a - k_p / a) (q - p) + (k_p / a) (q_j - p) with a = k_d / 2. All weights are >= 0 then, and
integrators with such weights agree for any bounded delays. With k_d² < 4 k_p the reference
overshoots, and the arms can diverge for delays that are long enough (preset ``... violating``).

At rest an arm that is held pulls with the stiffness k_p K / k_d, as a spring does; in motion the
hand feels the damping K. The paper's dynamic feedback differs in that, not in the delays it allows.

Source: A. Abdessameud, I. G. Polushin, A. Tayebi, "Synchronization of Lagrangian systems with
irregular communication delays", IEEE Trans. Automatic Control 59(1), 2014. The structure, a
reference filter fed by delayed positions and a tracking law, is from memory of that paper. Its
gains follow from a small-gain condition that contains a bound on the delay; that inequality is not
known here and not used.

Sampled: outputs as of t_k; z and theta_hat advance by the explicit Euler method. Each joint's
torque is limited to ±tau_max; while any joint is at its limit z and theta_hat stand still
(anti-windup).
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, rate
from fmus.arms.static_feedback import Feedback, LawSize, adaptive, mean_disagreement
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array

PRESETS: dict[str, dict[str, float]] = {
    "Abdessameud": {"K": 16.0, "Gamma": 1.0, "k_p": 1.0, "k_d": 2.0},
    "Abdessameud violating": {"K": 16.0, "Gamma": 1.0, "k_p": 4.0, "k_d": 0.5},
}

_ALL = ("q", "dq", "q_j")
_START = ("theta_hat", "z", "K", "k_p", "k_d", "tau_max")


def model(neighbours: int = 1) -> Model:
    """Declare the controller for `neighbours` >= 1; defaults: ``Abdessameud``. Raises FmuError."""
    return declare(LawSize(neighbours), __doc__)


def declare(size: LawSize, documentation: str | None) -> Model:
    """The controller of an arm of this `size`."""
    return size.controller(
        "abdessameud2014",
        "Adaptive consensus with another arm by a reference filter of second order",
        (
            size.received("q_j", "rad", "Received joint position"),
            size.arm.torque(
                _ALL, ("theta_hat", "z", "K", "k_p", "k_d", "tau_max"), elementwise=False
            ),
            size.arm.signal("s", RATE, "Sliding vector: dq - z", ("dq",), ("z",)),
            size.arm.vector("z", "output", RATE, "Reference velocity", settable=True),
            size.arm.local("z_next", RATE, "z of the next step"),
        ),
        (size.arm.gain("K", DAMPING, 16.0, "Feedback gain of s"),),
        (
            Variable("k_p", "parameter", (), "1/s2", 1.0, "Stiffness of the filter", minimum=0.0),
            rate("k_d", 2.0, "Damping of the filter"),
        ),
        documentation,
        Terminal("network", ("q_j",), "Position of the other arm"),
    )


def feedback(x: Values, q: Array, dq: Array, q_j: Array) -> Feedback:
    """The equations above: `q` (m,), `q_j` (m,) or (n, m) rad, as received; `dq` (m,)."""
    z = x["z_next"]
    s = dq - z
    return Feedback(s, z, -x["k_d"] * z - x["k_p"] * mean_disagreement(q, q_j), -x["K"] * s)


fmu, kernel, Abdessameud2014 = derive(model, *adaptive("s", feedback, dynamic=True))
