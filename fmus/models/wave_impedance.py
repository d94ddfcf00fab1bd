"""Impedance end of a wave-variable line: velocity of the arm in, torque out.

Let v be the wave that returns over the line (delayed). For each joint::

    F   = b dq - v          torque of the arm on the line
    tau = -F
    u   = b dq + F          sent: the outgoing wave

u and v are Niemeyer and Slotine's waves times sqrt(2 b), so that they are torques; b must be the
same at both ends. The power into the line is dq' F = sum of (u^2 - v^2) / (4 b). A line that
delays both waves by constant times only stores energy, so it is passive for any delay. Anderson and
Spong's scattering with the scale n is the same law with b = n^2.

Condition: b > 0 and constant delays (a link with ``semantics = "playout"`` provides these); a wave
held or repeated by a varying delay generates energy. Waves transmit velocities, so a position
difference at the start, or from lost waves, is permanent. The other end is ``wave_admittance``.

Source: G. Niemeyer, J.-J. E. Slotine, "Stable adaptive teleoperation", IEEE J. Oceanic Engineering
16(1), 1991; R. J. Anderson, M. W. Spong, "Bilateral control of teleoperators with time delay", IEEE
Trans. Automatic Control 34(5), 1989.

Sampled: inputs are read at t_k, outputs are held to the next step. Each joint's torque is limited
to ±tau_max; the wave u = v + 2 F then contains the limited torque, and the port stays passive.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np

#: ``scattering(n=3)`` is Anderson and Spong's with b = n^2.
PRESETS: dict[str, dict[str, float]] = {
    "wave(b=10)": {"b": 10.0},
    "scattering(n=3)": {"b": 9.0},
}


def model(joints: int = 2) -> Model:
    """Declare the end of the line for `joints`; the defaults are ``wave(b=10)``."""
    arm = Joints(joints)
    return Model(
        identifier="wave_impedance",
        description="End of a wave line: velocity in, torque out",
        kind="sampled",
        variables=(
            arm.dq,
            arm.input("v", TORQUE, "Received wave"),
            arm.torque(("dq", "v"), ("b", "tau_max")),
            arm.signal("u", TORQUE, "Wave sent: b dq + F", ("dq", "v"), ("b", "tau_max")),
            arm.gain("b", DAMPING, 10.0, "Wave impedance of the line", minimum=1e-6),
            arm.tau_max,
        ),
        sources=("wave_impedance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("dq", "tau"), "Velocity in, torque out"),
            Terminal("network", ("u", "v"), "Waves"),
        ),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, dq: Array, v: Array) -> Values:
    """The equations above: tau and u (m,) N.m of `dq` (m,) rad/s and the received `v` (m,) N.m."""
    F = np.clip(x["b"] * dq - v, -x["tau_max"], x["tau_max"])
    return {"tau": -F, "u": v + 2 * F}


fmu, kernel, WaveImpedance = derive(model, law)
