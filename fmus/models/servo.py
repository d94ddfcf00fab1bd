"""The servo of a robot that takes positions or velocities: what closes its inner loop.

Most arms take no torque. Each joint has a controller of its maker's, which is the same in both
modes and knows a reference q_r with its velocity dq_r::

    tau = K_v (f dq_r - dq) + K_p (q_r - q) + K_i ∫ (q_r - q) dt

    mode 0, velocity    dq_r = dq_c                      f = 1;  q_r = q(0) + ∫ dq_r dt
    mode 1, position    q_r goes to q_c along a line in the time T_c;  f = feed_forward

In velocity mode K_p is the gain of the integral of the velocity error. In position mode a new q_c
starts a new line; without one q_r stays where it is. A cascade of a position and a velocity loop
with the gains k_1 (1/s) and k_2 (N.m.s/rad) is K_v = k_2, K_p = k_1 k_2.

Its limits are those of makers' controllers: dq_r is limited to ±v_max and changes by a_max h at
most in a step h, and tau is limited to ±tau_max. While dq_r is limited, the line to q_c begins
anew, so that q_r arrives later and does not catch up. While tau is limited, both integrals stay.
`clamped` is 1 where something was limited from above, -1 where from below, and 0 elsewhere, so that
who commands can stop its own integrals.

Sampled: inputs are read at t_k, outputs are held to the next step. The servo stands between an arm
and whatever commands it, at its own period, which is shorter than that of the commands. A command
that comes late is one over a link (``[[links]]``) to q_c or dq_c.

Source: own construction; interpolation and limits as of the modes "cyclic synchronous position" and
"cyclic synchronous velocity" of IEC 61800-7-201 (CiA 402).
"""

from __future__ import annotations

from cosim.base.copies import replace
from fmus.arms.joints import DAMPING, RATE, STIFFNESS, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

#: Modes, and where there is no limit.
VELOCITY, POSITION = 0, 1
UNLIMITED = 1e9
INTEGRAL = "N.m/rad.s"


def mode() -> Variable:
    """The parameter `mode`: 0 velocities, 1 positions."""
    return Variable(
        *("mode", "parameter", (), "1", float(VELOCITY), "Commands: 0 velocity, 1 position"),
        type="integer",
        minimum=0.0,
        maximum=1.0,
    )


def feed_forward() -> Variable:
    """The share of dq_r that the servo takes in position mode."""
    text = "Position mode: the part of dq_r that is fed forward"
    return Variable("feed_forward", "parameter", (), "1", 1.0, text, minimum=0.0, maximum=1.0)


def gains(arm: Joints) -> tuple[Variable, ...]:
    """The gains of the inner loop, and the limits of the reference's velocity."""
    return (
        arm.gain("K_v", DAMPING, 10.0, "Gain of the velocity error"),
        arm.gain("K_p", STIFFNESS, 0.0, "Gain of the position error; mode 0: of the integral"),
        arm.gain("K_i", INTEGRAL, 0.0, "Gain of the integral of the position error"),
        arm.gain("v_max", RATE, UNLIMITED, "Limit of the reference's velocity"),
        arm.gain("a_max", "rad/s2", UNLIMITED, "Limit of the reference's acceleration"),
    )


def command(arm: Joints, name: str, unit: str, description: str) -> Variable:
    """An input that only one of the modes reads."""
    return replace(arm.input(name, unit, description), optional=True)


def model(joints: int = 7) -> Model:
    """Declare the servos of `joints`, by default for velocities, without limits.

    Raises FmuError for a number of joints that is not a whole number of at least 1.
    """
    arm = Joints(joints)
    motion = ("q", "dq", "q_c", "dq_c")
    return Model(
        identifier="servo",
        description="Servos of a robot that takes positions or velocities",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            command(arm, "q_c", "rad", "Commanded position"),
            command(arm, "dq_c", RATE, "Commanded velocity"),
            arm.torque(motion, ("dq", "K_v", "tau_max")),
            arm.signal("q_r", "rad", "Reference: position", ("q_c", "dq_c"), ("q",)),
            arm.signal("dq_r", RATE, "Reference: velocity", ("q_c", "dq_c")),
            arm.signal("clamped", "1", "1 limited from above, -1 from below, 0 not", motion),
            mode(),
            *gains(arm),
            arm.tau_max,
            feed_forward(),
            Variable("T_c", "parameter", (), "s", 4e-3, "Time in which q_r is at q_c", minimum=0.0),
            arm.local("q_next", "rad", "q_r of the next step"),
            arm.local("e_sum", "rad.s", "Integral of the position error"),
            arm.local("q_last", "rad", "q_c of the step before"),
            arm.local("left", "s", "Time in which q_r will be at q_c"),
        ),
        sources=("servo.c", "limit.h", "servo.h"),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("commands", ("q_c", "dq_c", "clamped"), "Commands in, whether limited out"),
        ),
        documentation=__doc__ or "",
    )


def start(x: Values, q: Array, dq: Array, q_c: Array, dq_c: Array) -> Values:
    """The servo at rest where the arm is; `q` (n,) rad, `dq` (n,) rad/s."""
    none = np.zeros_like(q)
    tau = np.clip(-x["K_v"] * dq, -x["tau_max"], x["tau_max"])
    rest = {"q_next": q, "e_sum": none, "q_last": q, "left": none}
    return {"tau": tau, "q_r": q, "dq_r": none, "clamped": none, **rest}


def law(x: Values, t: float, h: float, q: Array, dq: Array, q_c: Array, dq_c: Array) -> Values:
    """The equations above: tau (n,) N.m; `q`, `q_c` (n,) rad, `dq`, `dq_c` (n,) rad/s; `h` s."""
    q_r, by_velocity = x["q_next"], x["mode"] == VELOCITY
    left = np.where(q_c != x["q_last"], x["T_c"], x["left"])
    within = np.maximum(np.where(left > 0.0, left, x["T_c"]), h)
    asked = dq_c if by_velocity else (q_c - q_r) / within
    dq_r = limited_rate(x, asked, x["dq_r"], h)
    f = 1.0 if by_velocity else x["feed_forward"]
    error = q_r - q
    wanted = x["K_v"] * (f * dq_r - dq) + x["K_p"] * error + x["K_i"] * x["e_sum"]
    tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
    over = tau != wanted
    moved = np.where(over, dq, dq_r) if by_velocity else dq_r
    return {
        "tau": tau,
        "q_r": q_r,
        "dq_r": dq_r,
        "clamped": np.where(over, np.sign(wanted), np.sign(asked - dq_r)),
        "q_next": q_r + h * moved,
        "e_sum": np.where(over, x["e_sum"], x["e_sum"] + h * error),
        "q_last": q_c,
        "left": np.where(dq_r != asked, x["T_c"], np.where(left > 1.5 * h, left - h, 0.0)),
    }


def limited_rate(x: Values, asked: Array, before: Array, h: float) -> Array:
    """The velocity (n,), rad/s, that v_max and a_max leave of `asked`, after `before`, both (n,).

    `h` s is the time between them.
    """
    allowed = np.clip(asked, -x["v_max"], x["v_max"])
    change, most = allowed - before, x["a_max"] * h
    return np.where(change > most, before + most, np.where(change < -most, before - most, allowed))


fmu, kernel, Servo = derive(model, law, start)
