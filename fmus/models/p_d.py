"""P+d: a spring to the delayed position of the other arm and a damper to the ground.

For each joint, with the position q_j of the other arm as received (delayed)::

    tau = -K (q - q_j) - B dq

Condition, for arms l and r and delays of at most T_l, T_r, which may vary::

    4 B_l B_r > (T_l + T_r)^2 K_l K_r

Then velocities and position error stay bounded, and in a passive environment the free arms
synchronise. The proof uses V = |q_l - q_r|^2 / 2 plus the sum over the arms of dq' M dq / (2 K_i):
the contribution of the delayed spring to dV/dt is at most the dissipation of the dampers.

Source: E. Nuño, R. Ortega, N. Barabanov, L. Basañez, "A globally stable PD controller for
bilateral teleoperators", IEEE Trans. Robotics 24(3), 2008; E. Nuño, L. Basañez, R. Ortega,
M. Spong, "Position tracking for non-linear teleoperators with variable time delay", Int. J.
Robotics Research 28(7), 2009.

Sampled: inputs are read at t_k, outputs are held to the next step. Each joint's torque is limited
to ±tau_max.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, STIFFNESS, Joints, controller
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np

#: ``P+d`` meets the condition up to T_l + T_r = 2.5 s, ``P+d violating`` up to 0.6 s.
PRESETS: dict[str, dict[str, float]] = {
    "P+d": {"K": 10.0, "B": 12.5},
    "P+d violating": {"K": 10.0, "B": 3.0},
}


def model(joints: int = 2) -> Model:
    """Declare the controller of an arm of `joints`; the defaults are ``P+d``."""
    arm = Joints(joints)
    return controller(
        "p_d",
        "Spring to another arm and damper to the ground (P+d)",
        (
            arm.q_j,
            arm.torque(("q", "dq", "q_j"), ("K", "B", "tau_max")),
            arm.gain("K", STIFFNESS, 10.0, "Stiffness of the coupling"),
            arm.gain("B", DAMPING, 12.5, "Damping to the ground"),
            arm.tau_max,
        ),
        ("limit.h",),
        __doc__,
        Terminal("network", ("q_j",), "Position of the other arm"),
        joints=arm,
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, q_j: Array) -> Values:
    """The equation above, limited: tau (m,) N.m; `q`, `q_j` (m,) rad; `dq` (m,) rad/s."""
    wanted = -x["K"] * (q - q_j) - x["B"] * dq
    return {"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])}


fmu, kernel, PPlusD = derive(model, law)
