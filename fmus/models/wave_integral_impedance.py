"""Impedance end of a line that sends the integrals of waves: passive for any delay and loss.

The waves u and v are those of ``wave_impedance``. Each end sends the integral U of its wave and the
energy E = integral of u^2 / (4 b), both from the start, and keeps how much of what it received it
has given on, U_given and E_given. Of what is left it makes the wave w of the next step of h: for
each joint, with U_j and E_j as received::

    dU  = U_j - U_given
    dE  = E_j - E_given
    w   = 4 b dE / dU       uses up dU and dE together, or
    w   = dU / h            if one step is enough; the rest of dE is dissipated
    w   = 0                 if dE = 0
    F   = b dq - w          torque of the arm on the line
    tau = -F
    u   = b dq + F          the outgoing wave, which is integrated

The energy given on never exceeds the energy received, and this one never what the other end sent,
whatever the delay does: jumps, samples that are held, repeated, lost or overtaken. A lost packet
loses no part of a wave, since the next one contains its integral. Over a constant delay it is the
law of ``wave_impedance``. Waves transmit velocities, so a position difference at the start is
permanent. The other end is ``wave_integral_admittance``; b must be the same at both ends.

Condition: b > 0. The alternative, a gain f with f^2 <= 1 - dT/dt on the received wave, needs a
delay T that never jumps.

Source: G. Niemeyer, J.-J. E. Slotine, "Towards force-reflecting teleoperation over the Internet",
ICRA 1998, which sends both integrals. The amplitude of w is our own derivation from the two
balances, as their filter is known to us from memory only.

Sampled: inputs are read at t_k, outputs are held to the next step; U and E contain the wave of that
step. Each joint's torque is limited to ±tau_max; u = w + 2 F then contains the limited torque.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np

IMPULSE = "N.m.s"

PRESETS: dict[str, dict[str, float]] = {"wave integrals(b=10)": {"b": 10.0}}

_ALL = ("dq", "U_j", "E_j")


def model(joints: int = 2) -> Model:
    """Declare the end of the line for `joints`; the defaults are ``wave integrals(b=10)``."""
    arm = Joints(joints)
    return Model(
        identifier="wave_integral_impedance",
        description="End of a line of wave integrals: velocity in, torque out",
        kind="sampled",
        variables=(
            arm.dq,
            arm.input("U_j", IMPULSE, "Received integral of the wave"),
            arm.input("E_j", "J", "Received energy of the wave"),
            arm.torque(_ALL, ("b", "tau_max")),
            arm.signal("U", IMPULSE, "Integral of the wave b dq + F", _ALL),
            arm.signal("E", "J", "Energy of the wave b dq + F", _ALL),
            arm.local("U_given", IMPULSE, "Part of U_j given on"),
            arm.local("E_given", "J", "Part of E_j given on"),
            arm.gain("b", DAMPING, 10.0, "Wave impedance of the line", minimum=1e-6),
            arm.tau_max,
        ),
        sources=("wave_integral_impedance.c", "wave_integrals.h", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("dq", "tau"), "Velocity in, torque out"),
            Terminal("network", ("U", "E", "U_j", "E_j"), "Integrals of waves"),
        ),
        documentation=__doc__ or "",
    )


def wave_given(x: Values, h: float, U_j: Array, E_j: Array) -> tuple[Array, Values]:
    """The wave w (m,) N.m of a step of `h` (s), and U_given and E_given after it.

    `U_j` (m,) N.m.s and `E_j` (m,) J are the received integrals.
    """
    left, energy = U_j - x["U_given"], 4 * x["b"] * (E_j - x["E_given"])
    wave = np.divide(energy, left, out=np.zeros_like(left), where=left != 0.0)
    none = ~(energy > 0.0)
    part = np.abs(wave) * h < np.abs(left)
    w = np.where(none, 0.0, np.where(part, wave, left / h))
    U = np.where(none, x["U_given"], np.where(part, x["U_given"] + h * w, U_j))
    E = x["E_given"] + h * w * w / (4 * x["b"])
    return w, {"U_given": U, "E_given": np.where(none | part, E, E_j)}


def integrals(x: Values, h: float, wave: Array) -> Values:
    """U and E after a step of `h` (s) with the outgoing `wave` (m,) N.m."""
    return {"U": x["U"] + h * wave, "E": x["E"] + h * wave * wave / (4 * x["b"])}


def nothing_sent(like: Array) -> Values:
    """All integrals at the start, each of the shape of `like` (m,)."""
    return dict.fromkeys(("U", "E", "U_given", "E_given"), np.zeros_like(like))


def law(x: Values, t: float, h: float, dq: Array, U_j: Array, E_j: Array) -> Values:
    """The equations above: `dq` (m,) rad/s; `U_j` (m,) N.m.s; `E_j` (m,) J; `h` s."""
    w, given = wave_given(x, h, U_j, E_j)
    F = np.clip(x["b"] * dq - w, -x["tau_max"], x["tau_max"])
    return {"tau": -F} | integrals(x, h, w + 2 * F) | given


def start(x: Values, dq: Array, U_j: Array, E_j: Array) -> Values:
    """Outputs at the start, where no wave has come; shapes as in :func:`law`."""
    tau = -np.clip(x["b"] * dq, -x["tau_max"], x["tau_max"])
    return {"tau": tau} | nothing_sent(dq)


fmu, kernel, WaveIntegralImpedance = derive(model, law, start)
