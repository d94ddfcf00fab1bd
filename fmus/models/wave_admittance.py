"""Admittance end of a wave-variable line: torque in, desired velocity of the arm out.

Let u be the wave that arrives over the line (delayed). For each joint::

    tau    = F = K_p (q_d - q) + K_d (dq_d - dq)      spring and damper pull the arm to q_d
    b dq_d = u - F                                    desired velocity from wave and torque
    v      = b dq_d - F                               sent: the returning wave

The first two lines are one linear equation, with the solution dq_d = (u - K_p (q_d - q) + K_d dq) /
(b + K_d). At the start q_d is the position of the arm. ``wave_impedance``, the other end, explains
the waves and the condition. K_d = b matches the impedance of the line, so that fast changes are not
reflected.

Source: that of ``wave_impedance``.

Sampled: outputs as of t_k; q_d advances by the explicit Euler method. Each joint's torque is
limited to ±tau_max; v = u - 2 F then contains the limited torque, and the port stays passive.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, STIFFNESS, TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np

#: As those of ``wave_impedance``.
PRESETS: dict[str, dict[str, float]] = {
    "wave(b=10)": {"b": 10.0, "K_p": 50.0, "K_d": 10.0},
    "scattering(n=3)": {"b": 9.0, "K_p": 50.0, "K_d": 9.0},
}

_ALL = ("u", "q", "dq")


def model(joints: int = 2) -> Model:
    """Declare the end of the line for `joints`; the defaults are ``wave(b=10)``."""
    arm = Joints(joints)
    return Model(
        identifier="wave_admittance",
        description="End of a wave line: torque in, velocity to follow out",
        kind="sampled",
        variables=(
            arm.input("u", TORQUE, "Received wave"),
            arm.q,
            arm.dq,
            arm.torque(_ALL, ("b", "K_d", "tau_max")),
            arm.signal("v", TORQUE, "Wave sent: b dq_d - F", _ALL, ("b", "K_d", "tau_max")),
            arm.signal("q_d", "rad", "Position the arm is to be at", ("q",)),
            arm.local("q_d_next", "rad", "q_d of the next step"),
            arm.gain("b", DAMPING, 10.0, "Wave impedance of the line", minimum=1e-6),
            arm.gain("K_p", STIFFNESS, 50.0, "Stiffness towards q_d"),
            arm.gain("K_d", DAMPING, 10.0, "Damping towards dq_d"),
            arm.tau_max,
        ),
        sources=("wave_admittance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("u", "v"), "Waves"),
        ),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, u: Array, q: Array, dq: Array) -> Values:
    """The equations above; q_d advances to t + h, s.

    All are (m,): `u`, v and tau N.m; `q` and q_d rad; `dq` rad/s.
    """
    q_d, b, K_d = x["q_d_next"], x["b"], x["K_d"]
    spring = x["K_p"] * (q_d - q)
    dq_d = (u - spring + K_d * dq) / (b + K_d)
    F = np.clip(spring + K_d * (dq_d - dq), -x["tau_max"], x["tau_max"])
    return {"tau": F, "v": u - 2 * F, "q_d": q_d, "q_d_next": q_d + h * (u - F) / b}


def start(x: Values, u: Array, q: Array, dq: Array) -> Values:
    """At the start q_d is q; shapes as in :func:`law`."""
    return {"q_d_next": q}


fmu, kernel, WaveAdmittance = derive(model, law, start)
