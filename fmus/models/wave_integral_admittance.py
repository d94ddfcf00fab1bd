"""Admittance end of a line that sends the integrals of waves: torque in, velocity to follow out.

The line, the integrals U and E and the wave w made of the received ones are those of
``wave_integral_impedance``; the arm follows as in ``wave_admittance``. For each joint::

    tau    = F = K_p (q_d - q) + K_d (dq_d - dq)      spring and damper pull the arm to q_d
    b dq_d = w - F                                    desired velocity from wave and torque
    v      = b dq_d - F                               the outgoing wave, which is integrated

Source: those of ``wave_integral_impedance``.

Sampled: outputs as of t_k; q_d, which is q at the start, advances by the explicit Euler method.
Each joint's torque is limited to ±tau_max; v = w - 2 F then contains the limited torque.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, STIFFNESS, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np
from fmus.models.wave_integral_impedance import IMPULSE, integrals, nothing_sent, wave_given

#: As those of ``wave_integral_impedance``.
PRESETS: dict[str, dict[str, float]] = {
    "wave integrals(b=10)": {"b": 10.0, "K_p": 50.0, "K_d": 10.0},
}

_ALL = ("q", "dq", "U_j", "E_j")


def model(joints: int = 2) -> Model:
    """Declare the end of the line for `joints`; the defaults are ``wave integrals(b=10)``."""
    arm = Joints(joints)
    return Model(
        identifier="wave_integral_admittance",
        description="End of a line of wave integrals: torque in, velocity to follow out",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            arm.input("U_j", IMPULSE, "Received integral of the wave"),
            arm.input("E_j", "J", "Received energy of the wave"),
            arm.torque(_ALL, ("b", "K_d", "tau_max")),
            arm.signal("U", IMPULSE, "Integral of the wave b dq_d - F", _ALL),
            arm.signal("E", "J", "Energy of the wave b dq_d - F", _ALL),
            arm.signal("q_d", "rad", "Position the arm is to be at", ("q",)),
            arm.local("U_given", IMPULSE, "Part of U_j given on"),
            arm.local("E_given", "J", "Part of E_j given on"),
            arm.local("q_d_next", "rad", "q_d of the next step"),
            arm.gain("b", DAMPING, 10.0, "Wave impedance of the line", minimum=1e-6),
            arm.gain("K_p", STIFFNESS, 50.0, "Stiffness towards q_d"),
            arm.gain("K_d", DAMPING, 10.0, "Damping towards dq_d"),
            arm.tau_max,
        ),
        sources=("wave_integral_admittance.c", "wave_integrals.h", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("U", "E", "U_j", "E_j"), "Integrals of waves"),
        ),
        documentation=__doc__ or "",
    )


def _port(x: Values, w: Array, q_d: Array, q: Array, dq: Array) -> Array:
    """The torque F (m,) N.m for the wave `w` (m,) N.m."""
    spring = x["K_p"] * (q_d - q)
    dq_d = (w - spring + x["K_d"] * dq) / (x["b"] + x["K_d"])
    return np.clip(spring + x["K_d"] * (dq_d - dq), -x["tau_max"], x["tau_max"])


def law(x: Values, t: float, h: float, q: Array, dq: Array, U_j: Array, E_j: Array) -> Values:
    """The equations above; q_d advances to t + h, s.

    All are (m,): `q` and q_d rad; `dq` rad/s; `U_j` N.m.s; `E_j` J; tau N.m.
    """
    q_d = x["q_d_next"]
    w, given = wave_given(x, h, U_j, E_j)
    F = _port(x, w, q_d, q, dq)
    moved = {"q_d": q_d, "q_d_next": q_d + h * (w - F) / x["b"]}
    return {"tau": F} | moved | integrals(x, h, w - 2 * F) | given


def start(x: Values, q: Array, dq: Array, U_j: Array, E_j: Array) -> Values:
    """Outputs at the start, where q_d is q and no wave has come; shapes as in :func:`law`."""
    tau = _port(x, np.zeros_like(q), q, q, dq)
    return {"tau": tau, "q_d": q, "q_d_next": q} | nothing_sent(q)


fmu, kernel, WaveIntegralAdmittance = derive(model, law, start)
