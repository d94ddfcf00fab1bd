"""PD with dissipation: spring and damper to the delayed other arm, and damping for the delay.

For each joint, with the motion q_j, dq_j of the other arm as received (delayed)::

    tau = -K_v (dq - dq_j) - (K_d + P_eps) dq - K_p (q - q_j)

Condition, for a constant delay of at most T_rt round trip::

    K_d >= (T_rt / 2) K_p,   P_eps > 0

Then the coupling and the links together are passive in any environment: K_d dissipates the energy
of the delayed spring, the delayed damper is passive by itself, and P_eps is the passivity margin.

Source: D. Lee, M. W. Spong, "Passive bilateral teleoperation with constant time delay", IEEE
Trans. Robotics 22(2), 2006.

Sampled: inputs are read at t_k, outputs are held to the next step. Each joint's torque is limited
to ±tau_max.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, STIFFNESS, Joints, controller
from fmus.build.reference import Values, derive
from fmus.model import Model
from fmus.model.numeric import Array, np

#: Meets the condition up to T_rt = 2.4 s.
PRESETS: dict[str, dict[str, float]] = {
    "Lee-Spong": {"K_v": 4.0, "K_d": 12.0, "P_eps": 0.1, "K_p": 10.0},
}


def model(joints: int = 2) -> Model:
    """Declare the controller of an arm of `joints`; the defaults are ``Lee-Spong``."""
    arm = Joints(joints)
    return controller(
        "lee_spong",
        "PD coupling with another arm, and dissipation for the delay",
        (
            arm.q_j,
            arm.dq_j,
            arm.torque(("q", "dq", "q_j", "dq_j"), ("K_v", "K_d", "P_eps", "K_p", "tau_max")),
            arm.gain("K_v", DAMPING, 4.0, "Damping of the coupling"),
            arm.gain("K_d", DAMPING, 12.0, "Damping to the ground, for the delayed spring"),
            arm.gain("P_eps", DAMPING, 0.1, "Damping to the ground beyond that"),
            arm.gain("K_p", STIFFNESS, 10.0, "Stiffness of the coupling"),
            arm.tau_max,
        ),
        ("limit.h",),
        __doc__,
        joints=arm,
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Values:
    """The equation above, limited: tau (m,) N.m; `q`, `q_j` (m,) rad; `dq`, `dq_j` (m,) rad/s."""
    coupling = -x["K_v"] * (dq - dq_j) - x["K_p"] * (q - q_j)
    wanted = coupling - (x["K_d"] + x["P_eps"]) * dq
    return {"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])}


fmu, kernel, LeeSpong = derive(model, law)
