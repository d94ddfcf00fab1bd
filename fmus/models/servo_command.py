"""Commands of position or velocity with which a ``servo`` gives a wanted torque.

It makes a law for torques usable on a robot that takes none. It knows the gains of the servo, keeps
its reference q_r, and chooses the reference's velocity so that the servo's law has the wanted
torque as its value at the end of the period T, if the arm keeps its velocity. For each joint, with
e = q_r - q::

    tau = K_v (f dq_c - dq) + K_p (e + T (dq_c - dq)) + K_i ∫ e dt
    q_c = q_r + T dq_c,   and q_r of the next period is q_c

`mode` and `feed_forward` f are those of the servo (f = 1 in velocity mode), so that one of K_p and
f K_v must be more than 0. Without f it is q_c = q + (tau + K_v dq)/K_p.

**Exact** while the servo is linear and not limited, and for T -> 0: the reference then obeys
f K_v de/dt + K_p e = tau + (1 - f) K_v dq, whose zero -K_p/(f K_v) is stable. Within a period the
servo resists a change of velocity that the law did not ask for, which acts like more inertia: with
M of the joint and a command that is d <= T late, under a constant torque::

    K_v T (1 + exp(K_v d/M)/(exp(K_v T/M) - 1))       about M + K_v (T/2 + d) for a short period

So K_v T must be small against M: a fast servo needs fast commands.

**Limits.** dq_c keeps within `v_max` and `a_max`, which should be the servo's. `clamped` is that of
the servo: where it is not 0 in velocity mode, q_r moves with the arm, as the servo's own integral
stays. In position mode nothing winds up, since q_c follows from the measured position. The torque
limit is that of the law: give its `tau_max` the servo's.

Sampled: outputs as of t_k.

Source: own construction (inversion of the servo's law by one backward difference).
"""

from __future__ import annotations

from cosim.base.errors import ScenarioError
from fmus.arms.joints import RATE, TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np
from fmus.models import servo
from fmus.models.servo import VELOCITY, limited_rate


def model(joints: int = 7) -> Model:
    """Declare the commands to the servos of `joints`; defaults are those of ``servo``.

    Raises FmuError for a number of joints that is not a whole number of at least 1.
    """
    arm = Joints(joints)
    wanted = ("q", "dq", "tau")
    return Model(
        identifier="servo_command",
        description="Commands of position or velocity that make a servo give a wanted torque",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            arm.input("tau", TORQUE, "Wanted torque"),
            servo.command(arm, "clamped", "1", "1, -1 where the servo is limited, 0 elsewhere"),
            arm.signal("q_c", "rad", "Commanded position", wanted, ("q",)),
            arm.signal("dq_c", RATE, "Commanded velocity", wanted),
            servo.mode(),
            *servo.gains(arm),
            servo.feed_forward(),
            arm.local("q_r", "rad", "Reference of the servo"),
            arm.local("e_sum", "rad.s", "Integral of the position error"),
        ),
        sources=("servo_command.c", "limit.h", "servo.h"),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion and wanted torque in"),
            Terminal("commands", ("q_c", "dq_c", "clamped"), "Commands out, whether limited in"),
        ),
        documentation=__doc__ or "",
    )


def start(x: Values, q: Array, dq: Array, tau: Array, clamped: Array) -> Values:
    """At rest where the arm is; `q` (n,) rad. Raises ScenarioError if no command has an effect."""
    f = 1.0 if x["mode"] == VELOCITY else x["feed_forward"]
    for i in np.flatnonzero(f * x["K_v"] + x["K_p"] <= 0.0):
        raise ScenarioError(
            "K_p and the K_v that is fed forward are both 0; expected a servo that a command moves",
            f"servo_command.K_p[{i}]",
        )
    none = np.zeros_like(q)
    return {"q_c": q, "dq_c": none, "q_r": q, "e_sum": none}


def law(x: Values, t: float, h: float, q: Array, dq: Array, tau: Array, clamped: Array) -> Values:
    """The equations above: q_c (n,) rad, dq_c (n,) rad/s of `tau` (n,) N.m; `h` s.

    `q` (n,) rad, `dq` (n,) rad/s, `clamped` (n,) without a unit.
    """
    by_velocity = x["mode"] == VELOCITY
    f = 1.0 if by_velocity else x["feed_forward"]
    error = x["q_r"] - q
    damped = (x["K_v"] + x["K_p"] * h) * dq
    pull = tau + damped - x["K_p"] * error - x["K_i"] * x["e_sum"]
    asked = pull / (f * x["K_v"] + x["K_p"] * h)
    dq_c = limited_rate(x, asked, x["dq_c"], h)
    held = clamped != 0.0
    moved = np.where(held, dq, dq_c) if by_velocity else dq_c
    return {
        "q_c": x["q_r"] + h * dq_c,
        "dq_c": dq_c,
        "q_r": x["q_r"] + h * moved,
        "e_sum": np.where(held, x["e_sum"], x["e_sum"] + h * error),
    }


fmu, kernel, ServoCommand = derive(model, law, start)
