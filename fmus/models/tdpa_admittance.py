"""Admittance end of a line with time-domain passivity control: torque in, desired motion out.

Let v_j be the velocity of the other end, E_j the energy it put into the line and q_j its position,
all as received (delayed). For each joint::

    w     = v_j + k_c (q_j - q_d)                         velocity demanded by the line
    tau   = f = K_p (q_d - q) + K_d (dq_d - dq)           spring and damper pull the arm to q_d
    dq_d  = w - B f                                       velocity after the passivity controller

    E     = sum of the work f w h where it is negative    into the line; sent with f
    E_out = sum of the work where it is positive          out of the line
    E_pc  = sum of B f^2 h                                dissipated by the passivity controller
    W     = E_0 + max E_j - E_out + E_pc                  energy that the line may still deliver

B is the least B >= 0 with h f dq_d <= W in the next step; if no B suffices, it is the one with the
least f dq_d. f depends on dq_d: with a = K_p (q_d - q) - K_d dq the work is f dq_d = f (f - a) /
K_d, and f is found between 0 and its value for dq_d = w. For any delays and losses, the line
delivers at most its input energy plus E_0; ``tdpa_impedance``, the other end, explains this. E_0 is
the energy of the line at the start. With E_0 = 0 no torque appears against which the other end
could do work, and the arms never move. A frictionless joint of inertia m may reach sqrt(2 E_0 / m):
0.045 rad/s for the preset of 1 mJ and 1 kg.m^2, hence the small value.

The passivity controller reduces dq_d, which causes a position error (drift). With k_c > 0 the line
also demands the lost position, as fast as its energy allows. This drift compensation is applied
inside the observed port. With k_c = 0 the scheme is the plain one, and q_j is not used.

Source: those of ``tdpa_impedance``; for k_c, J. Artigas, J.-H. Ryu, C. Preusche, "Position drift
compensation in time domain passivity based teleoperation", IROS 2010.

Sampled: outputs as of t_k; q_d, which is q at the start, and the energies advance to t_k + h. Each
joint's torque is limited to ±tau_max by a limit of dq_d, so that q_d does not run away from an arm
that cannot follow.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, STIFFNESS, TORQUE, Joints, rate
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

#: As those of ``tdpa_impedance``; ``TDPA drift`` with compensation.
PRESETS: dict[str, dict[str, float]] = {
    "TDPA": {"K_p": 50.0, "K_d": 10.0, "E_0": 1e-3, "k_c": 0.0},
    "TDPA drift": {"K_p": 50.0, "K_d": 10.0, "E_0": 1e-3, "k_c": 1.0},
}

_ALL = ("q", "dq", "v_j", "E_j", "q_j")


def _inputs(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.q,
        arm.dq,
        arm.input("v_j", RATE, "Received velocity"),
        arm.input("E_j", "J", "Received energy into the line"),
        arm.q_j,
    )


def _outputs(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.torque(_ALL, ()),
        arm.signal("f", TORQUE, "Torque sent: tau", _ALL),
        arm.vector("E", "output", "J", "Energy into the line"),
        arm.signal("W", "J", "Energy the line may still give", ("E_j",), ("E_0",)),
        arm.signal("q_d", "rad", "Position the arm is to be at", ("q",)),
        arm.local("q_d_next", "rad", "q_d of the next step"),
        arm.local("E_next", "J", "E of the next step"),
        arm.local("E_seen", "J", "Most of E_j received so far"),
        arm.local("E_out", "J", "Energy out of the line"),
        arm.local("E_pc", "J", "Energy taken by the controller"),
    )


def model(joints: int = 2) -> Model:
    """Declare the end of the line for `joints`; the defaults are ``TDPA``."""
    arm = Joints(joints)
    return Model(
        identifier="tdpa_admittance",
        description="End of a line kept passive in the time domain: torque in, motion out",
        kind="sampled",
        variables=(
            *_inputs(arm),
            *_outputs(arm),
            arm.gain("K_p", STIFFNESS, 50.0, "Stiffness towards q_d"),
            arm.gain("K_d", DAMPING, 10.0, "Damping towards dq_d", minimum=1e-6),
            arm.gain("E_0", "J", 1e-3, "Energy in the line at the start"),
            rate("k_c", 0.0, "Gain of the drift compensation"),
            arm.tau_max,
        ),
        sources=("tdpa_admittance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("f", "E", "v_j", "E_j", "q_j"), "Torque and energy out, flow in"),
        ),
        documentation=__doc__ or "",
    )


def law(
    x: Values, t: float, h: float, q: Array, dq: Array, v_j: Array, E_j: Array, q_j: Array
) -> Values:
    """The equations above; q_d and the energies advance to t + h, s.

    All are (m,): `q`, `q_j` rad; `dq`, `v_j` rad/s; `E_j` J; the torques tau and f N.m.
    """
    q_d, E = x["q_d_next"], x["E_next"]
    w = v_j + x["k_c"] * (q_j - q_d)
    a = x["K_p"] * (q_d - q) - x["K_d"] * dq
    E_seen = np.maximum(x["E_seen"], E_j)
    W = x["E_0"] + E_seen - x["E_out"] + x["E_pc"]
    f = _affordable(a + x["K_d"] * w, a, x["K_d"] * W / h, x["tau_max"])
    dq_d = (f - a) / x["K_d"]
    out = h * f * w
    return {
        **{"tau": f, "f": f, "E": E, "W": W, "q_d": q_d},
        "q_d_next": q_d + h * dq_d,
        "E_next": E + np.maximum(-out, 0.0),
        "E_seen": E_seen,
        "E_out": x["E_out"] + np.maximum(out, 0.0),
        "E_pc": x["E_pc"] + h * f * (w - dq_d),
    }


def _affordable(wanted: Array, a: Array, room: Array, tau_max: Array) -> Array:
    """F from 0 to `wanted`, limited, with f (f - a) <= `room`, or the least f (f - a)."""
    sign = np.where(wanted < 0, -1.0, 1.0)
    most, a = np.minimum(sign * wanted, tau_max), sign * a
    f = a / 2 + np.sqrt(np.maximum(a * a / 4 + room, 0.0))
    return np.asarray(sign * np.where(most * (most - a) <= room, most, np.clip(f, 0.0, most)))


def start(x: Values, q: Array, dq: Array, v_j: Array, E_j: Array, q_j: Array) -> Values:
    """Outputs at the start, where q_d is q and all energies are 0; shapes as in :func:`law`."""
    none = np.zeros_like(q)
    outputs = {"tau": none, "f": none, "E": none, "W": x["E_0"] + E_j, "q_d": q}
    return outputs | {"q_d_next": q, "E_next": none, "E_seen": E_j, "E_out": none, "E_pc": none}


fmu, kernel, TdpaAdmittance = derive(model, law, start)
