"""Plain PD: a spring and a damper to the delayed motion of the other arm.

For each joint, with the motion q_j, dq_j of the other arm as received (delayed)::

    tau = -K_p (q - q_j) - K_d (dq - dq_j)

Condition: no condition guarantees stability with delay. Without delay any K_p, K_d > 0
synchronise the arms. The delayed spring and damper generate energy that the law does not dissipate.

Two settings serve as baselines of a comparison: K_p = K_d = 0 leaves both arms free (zero force),
and gains on one side only make that side follow the other (unilateral). Wired to a moving target
(``minimum_jerk``) instead of another arm, the model is the arm of an operator.

Source: the position-position coupling of most leader-follower systems; the uncompensated case from
which D. Lee, M. W. Spong, "Passive bilateral teleoperation with constant time delay", IEEE Trans.
Robotics 22(2), 2006, and E. Nuño, L. Basañez, R. Ortega, "Passivity-based control for bilateral
teleoperation: a tutorial", Automatica 47(3), 2011, start.

Sampled: inputs are read at t_k, outputs are held to the next step. Each joint's torque is limited
to ±tau_max.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, STIFFNESS, Joints, controller
from fmus.build.reference import Values, derive
from fmus.model import Model
from fmus.model.numeric import Array, np

#: The side-by-side comparison's gains; ``free`` is the control without coupling.
PRESETS: dict[str, dict[str, float]] = {
    "PD(10,4)": {"K_p": 10.0, "K_d": 4.0},
    "PD(50,10)": {"K_p": 50.0, "K_d": 10.0},
    "free": {"K_p": 0.0, "K_d": 0.0},
}


def model(joints: int = 2) -> Model:
    """Declare the controller of an arm of `joints`; the defaults are ``PD(10,4)``."""
    arm = Joints(joints)
    return controller(
        "pd",
        "Plain PD coupling with another arm",
        (
            arm.q_j,
            arm.dq_j,
            arm.torque(("q", "dq", "q_j", "dq_j"), ("K_p", "K_d", "tau_max")),
            arm.gain("K_p", STIFFNESS, 10.0, "Stiffness of the coupling"),
            arm.gain("K_d", DAMPING, 4.0, "Damping of the coupling"),
            arm.tau_max,
        ),
        ("limit.h",),
        __doc__,
        joints=arm,
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Values:
    """The equation above, limited: tau (m,) N.m; `q`, `q_j` (m,) rad; `dq`, `dq_j` (m,) rad/s."""
    wanted = -x["K_p"] * (q - q_j) - x["K_d"] * (dq - dq_j)
    return {"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])}


fmu, kernel, PD = derive(model, law)
