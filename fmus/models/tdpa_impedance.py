"""Impedance end of a line with time-domain passivity control: velocity in, torque out.

A passivity observer integrates the energy that enters and leaves the line, and a passivity
controller dissipates any excess by damping. Let f_j be the torque of the other end and E_j the
energy it put into the line, both as received (delayed). For each joint::

    E     = sum of the work f_j dq h where that is positive     into the line; sent with dq
    E_out = sum of the work where it is negative                out of the line
    W     = max E_j - E_out + E_pc                              energy it may still deliver
    f     = f_j + a dq,   a = min(-W / (h dq^2), a_max) if W < 0, else 0
    tau   = -f,           E_pc = sum of the work (f - f_j) dq h

max E_j is the largest received value: energies never decrease, so a late packet changes nothing. W
falls below zero only by the amount that a_max defers to later steps. For any delays and losses, the
line therefore delivers at most its input energy, without a condition on the gains. E_j and f_j must
travel in the same packets (links of one ``channel``). The work is exact, because torques are held
and dq h is the angle of the step. The other end, ``tdpa_admittance``, follows v = dq.

Source: B. Hannaford, J.-H. Ryu, "Time-domain passivity control of haptic interfaces", IEEE Trans.
Robotics and Automation 18(1), 2002; J.-H. Ryu, J. Artigas, C. Preusche, "A passive bilateral
control scheme for a teleoperator with time-varying communication delay", Mechatronics 20(7), 2010.

Sampled: outputs as of t_k. a_max keeps the damper stable at the step h: h a_max must be well below
the arm's inertia. Each joint's torque is limited to ±tau_max; E_pc includes the work that the limit
changes.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

PRESETS: dict[str, dict[str, float]] = {"TDPA": {"a_max": 20.0}, "TDPA drift": {"a_max": 20.0}}


def _inputs(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.q,
        arm.dq,
        arm.input("f_j", TORQUE, "Received torque"),
        arm.input("E_j", "J", "Received energy into the line"),
    )


def _outputs(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.torque(("q", "dq", "f_j", "E_j"), ("tau_max",)),
        arm.signal("v", RATE, "Velocity sent: dq", ("dq",)),
        arm.signal("E", "J", "Energy into the line", ("q",)),
        arm.signal("W", "J", "Energy the line may still give", ("q", "E_j")),
        arm.local("E_seen", "J", "Most of E_j received so far"),
        arm.local("E_out", "J", "Energy out of the line"),
        arm.local("E_pc", "J", "Energy taken by the controller"),
        arm.local("q_last", "rad", "q of the step before"),
        arm.local("f_last", TORQUE, "f_j of the step before"),
    )


def model(joints: int = 2) -> Model:
    """Declare the end of the line for `joints`; the defaults are ``TDPA``."""
    arm = Joints(joints)
    return Model(
        identifier="tdpa_impedance",
        description="End of a line kept passive in the time domain: velocity in, torque out",
        kind="sampled",
        variables=(
            *_inputs(arm),
            *_outputs(arm),
            arm.gain("a_max", DAMPING, 20.0, "Most damping of the passivity controller"),
            arm.tau_max,
        ),
        sources=("tdpa_impedance.c", "limit.h"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),
            Terminal("network", ("v", "E", "f_j", "E_j"), "Flow and energy out, torque in"),
        ),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, f_j: Array, E_j: Array) -> Values:
    """The equations above; `tau`, `q_last` and `f_last` in `x` are of the step before.

    All are (m,): `q` rad; `dq` and v rad/s; `f_j` and tau N.m; `E_j` J. `h` is in s.
    """
    passed = q - x["q_last"]
    work = x["f_last"] * passed
    E, E_out = x["E"] + np.maximum(work, 0.0), x["E_out"] - np.minimum(work, 0.0)
    E_pc = x["E_pc"] - (x["tau"] + x["f_last"]) * passed
    E_seen = np.maximum(x["E_seen"], E_j)
    W = E_seen - E_out + E_pc
    f = f_j + _damping(x["a_max"], W, dq, h) * dq
    tau = np.clip(-f, -x["tau_max"], x["tau_max"])
    outputs = {"tau": tau, "v": dq, "E": E, "W": W}
    return outputs | {"E_seen": E_seen, "E_out": E_out, "E_pc": E_pc, "q_last": q, "f_last": f_j}


def _damping(a_max: Array, W: Array, dq: Array, h: float) -> Array:
    """The passivity controller's damping a, N.m.s/rad, of each joint, for W in J, dq in rad/s."""
    owed, room = -W, h * dq * dq
    enough = owed < a_max * room
    a = np.where(enough, owed / np.where(enough, room, 1.0), a_max)
    return np.where(owed > 0.0, a, 0.0)


def start(x: Values, q: Array, dq: Array, f_j: Array, E_j: Array) -> Values:
    """Outputs at the start, where all energies of this end are 0; shapes as in :func:`law`."""
    none = np.zeros_like(q)
    tau = np.clip(-f_j, -x["tau_max"], x["tau_max"])
    state = {"E_seen": E_j, "E_out": none, "E_pc": none, "q_last": q, "f_last": f_j}
    return {"tau": tau, "v": dq, "E": none, "W": E_j} | state


fmu, kernel, TdpaImpedance = derive(model, law, start)
