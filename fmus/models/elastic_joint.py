"""Joint under a drive in MIT mode, with an elastic gear and an elastic stand: what vibrates.

Each joint is a robot of its own: a motor, a gear as a spring, a link, and a stand that yields. The
drive has the spring and damper of its command (q_d, dq_d), and adds a compensation of friction with
a velocity dq_c that the host may know late::

    u            = K_p (q_d - q) + K_d (dq_d - dq) + F_c tanh(dq_c / v_c) + F_v dq_c
    tau          = u, limited to ±tau_max
    J ddq        = tau - damping dq - friction tanh(dq / v_f) - tau_g
    M (ddq_l + ddphi) = tau_g + tau_ext          tau_g = -k_g e - d_g de,   q_l = q + e
    M_s ddphi    = -k_s phi - d_s dphi - tau_g

q is the position of the motor behind the gear, e the twist of the gear, phi that of the stand.
k_g = 0 is a rigid gear (e = 0, and J + M is one inertia), k_s = 0 a rigid stand (phi = 0). The
rotor turns much faster than the stand, so that the rotation of the stand does not change its spin.

Conditions: gravity is balanced and left out. The loop of the drive is continuous; a step h times
the highest frequency of the springs must be below 1 or so.

Source: own construction; the elastic joint is that of M. W. Spong, "Modeling and control of elastic
joint robots", J. Dynamic Systems, Measurement, and Control 109(4), 1987.

Continuous, integrated by the classical Runge-Kutta method of order 4 with `substeps` equal
substeps of each joint, or with more, n, where friction would make the method unstable:
h (damping + friction / v_f) <= 2.5 n times the inertia that it moves. More than 1000 are refused.
Inputs are held over the step.
"""

from __future__ import annotations

from collections.abc import Mapping

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from fmus.arms.joints import DAMPING, RATE, STIFFNESS, TORQUE, Joints
from fmus.arms.stiff import steps_in
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

_INERTIA = "kg.m2"
_STATE = ("q", "dq", "e", "de", "phi", "dphi")
_GAINS = ("K_p", "K_d", "F_c", "v_c", "F_v", "tau_max")


def model(joints: int = 2) -> Model:
    """Declare `joints` joints; by default rigid, without friction, on a rigid stand."""
    arm = Joints(joints)
    return Model(
        identifier="elastic_joint",
        description="Joint under a drive in MIT mode, with elastic gear and stand",
        kind="continuous",
        variables=(*_ports(arm), *_drive(arm), *_mechanics(arm)),
        sources=(
            "elastic_joint.c",
            "limit.h",
            "hyperbolic.c",
            "hyperbolic.h",
            "stiff.h",
        ),
        step=1e-4,
        terminals=(Terminal("joints", ("q_d", "dq_d", "q", "dq"), "Command in, motion out"),),
        documentation=__doc__ or "",
    )


def _ports(arm: Joints) -> tuple[Variable, ...]:
    inputs = ("q_d", "dq_d", "dq_c")
    return (
        arm.input("q_d", "rad", "Commanded position"),
        arm.input("dq_d", RATE, "Commanded velocity"),
        arm.input("dq_c", RATE, "Velocity whose friction is compensated"),
        replace(arm.input("tau_ext", TORQUE, "External torque on the link"), optional=True),
        arm.vector("q", "output", "rad", "Position of the motor", settable=True),
        arm.vector("dq", "output", RATE, "Velocity of the motor", settable=True),
        arm.vector("e", "output", "rad", "Twist of the gear", settable=True),
        arm.vector("de", "output", RATE, "Rate of the twist of the gear", settable=True),
        arm.vector("phi", "output", "rad", "Rotation of the stand", settable=True),
        arm.vector("dphi", "output", RATE, "Velocity of the stand", settable=True),
        arm.signal("tau", TORQUE, "Torque of the motor", inputs, ("q", "dq", *_GAINS)),
    )


def _drive(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.gain("K_p", STIFFNESS, 10.0, "Stiffness of the command"),
        arm.gain("K_d", DAMPING, 1.0, "Damping of the command"),
        arm.gain("F_c", TORQUE, 0.0, "Compensated Coulomb friction"),
        arm.gain("v_c", RATE, 0.1, "Velocity at which 76 % of F_c are compensated", 1e-6),
        arm.gain("F_v", DAMPING, 0.0, "Compensated viscous friction"),
        arm.tau_max,
    )


def _mechanics(arm: Joints) -> tuple[Variable, ...]:
    return (
        arm.gain("J", _INERTIA, 0.01, "Inertia of the rotor behind the gear"),
        arm.gain("M", _INERTIA, 1.0, "Inertia of the link, more than 0"),
        arm.gain("damping", DAMPING, 0.0, "Viscous friction"),
        arm.gain("friction", TORQUE, 0.0, "Coulomb friction"),
        arm.gain("v_f", RATE, 0.1, "Velocity at which 76 % of the Coulomb friction act", 1e-6),
        arm.gain("k_g", STIFFNESS, 0.0, "Stiffness of the gear, 0 = rigid"),
        arm.gain("d_g", DAMPING, 0.0, "Damping of the gear"),
        arm.gain("M_s", _INERTIA, 1.0, "Inertia of the stand"),
        arm.gain("k_s", STIFFNESS, 0.0, "Stiffness of the stand, 0 = rigid"),
        arm.gain("d_s", DAMPING, 0.0, "Damping of the stand"),
        Variable(
            "substeps",
            "parameter",
            start=1.0,
            description="Integrator steps in a communication step",
            type="integer",
            minimum=1.0,
        ),
    )


def law(
    x: Values, t: float, h: float, q_d: Array, dq_d: Array, dq_c: Array, tau_ext: Array
) -> Values:
    """The motion over [t, t + h), s, with the inputs held, (n,) in the units of the ports."""
    y = np.array([x[name] for name in _STATE])  # (6, n)

    def slope(y: Array) -> Array:
        return rate(x, y, motor(x, y[0], y[1], q_d, dq_d, dq_c), tau_ext)

    steps = _steps(x, h)  # (n,)
    for n in range(int(steps.max())):
        step = h / steps
        k1 = slope(y)
        k2 = slope(y + step / 2 * k1)
        k3 = slope(y + step / 2 * k2)
        later = y + step / 6 * (k1 + 2 * k2 + 2 * k3 + slope(y + step * k3))
        y = np.where(n < steps, later, y)
    return {**dict(zip(_STATE, y, strict=True)), "tau": motor(x, y[0], y[1], q_d, dq_d, dq_c)}


def _steps(x: Values, h: float) -> Array:
    """Steps of the integrator in h of each joint, (n,), in which friction is stable."""
    common = np.where(x["k_s"] > 0.0, x["M"] ** 2 / (x["M_s"] + x["M"]), 0.0)
    inertia = np.where(x["k_g"] > 0.0, x["J"], x["J"] + x["M"] - common)
    rates = (x["damping"] + x["friction"] / x["v_f"]) / inertia
    least = int(x["substeps"])
    return np.array([steps_in(h, float(rate), least, "elastic_joint") for rate in rates])


def motor(x: Values, q: Array, dq: Array, q_d: Array, dq_d: Array, dq_c: Array) -> Array:
    """tau, N.m, (n,): the torque of the motor, limited."""
    friction = x["F_c"] * np.tanh(dq_c / x["v_c"]) + x["F_v"] * dq_c
    wanted = x["K_p"] * (q_d - q) + x["K_d"] * (dq_d - dq) + friction
    return np.clip(wanted, -x["tau_max"], x["tau_max"])


def rate(x: Values, y: Array, tau: Array, tau_ext: Array) -> Array:
    """The derivative of the state `y` (6, n) under the torques tau, tau_ext (n,) N.m."""
    _, dq, e, de, phi, dphi = y
    gear, stand = x["k_g"] > 0.0, x["k_s"] > 0.0
    J, M, M_s = x["J"], x["M"], np.where(stand, x["M_s"], 1.0)
    driven = tau - x["damping"] * dq - x["friction"] * np.tanh(dq / x["v_f"])
    yields = -x["k_s"] * phi - x["d_s"] * dphi
    # an elastic gear
    tau_g = -x["k_g"] * e - x["d_g"] * de
    ddq = (driven - tau_g) / np.where(gear, J, 1.0)
    ddphi = np.where(stand, (yields - tau_g) / M_s, 0.0)
    dde = (tau_g + tau_ext) / M - ddphi - ddq
    # a rigid one, on an elastic or a rigid stand
    own, base = driven + tau_ext, yields + tau_ext
    common = (J + M) * (M_s + M) - M * M
    moved = np.where(stand, ((M_s + M) * own - M * base) / common, own / (J + M))
    sways = np.where(stand, ((J + M) * base - M * own) / common, 0.0)
    zero = np.zeros_like(e)
    return np.array(
        [
            dq,
            np.where(gear, ddq, moved),
            np.where(gear, de, zero),
            np.where(gear, dde, zero),
            np.where(stand, dphi, zero),
            np.where(gear, ddphi, sways),
        ]
    )


def start(x: Values, q_d: Array, dq_d: Array, dq_c: Array, tau_ext: Array) -> Values:
    """Outputs at the start, (n,). Raises ScenarioError for inertias that no joint has."""
    for name, why in _impossible(x):
        raise ScenarioError(why, f"elastic_joint.{name}")
    twisted, sways = x["k_g"] > 0.0, x["k_s"] > 0.0
    state = {name: x[name] for name in _STATE}
    state |= {name: np.where(twisted, x[name], 0.0) for name in ("e", "de")}
    state |= {name: np.where(sways, x[name], 0.0) for name in ("phi", "dphi")}
    return {**state, "tau": motor(x, x["q"], x["dq"], q_d, dq_d, dq_c)}


def _impossible(x: Mapping[str, Array]) -> list[tuple[str, str]]:
    """Inertias that are 0 where a division needs more: their names and a sentence."""
    found = []
    if not (x["M"] > 0.0).all():
        found.append(("M", "M is 0; expected more than 0"))
    if ((x["k_g"] > 0.0) & (x["J"] <= 0.0)).any():
        found.append(("J", "J is 0 with an elastic gear; expected more than 0"))
    if ((x["k_s"] > 0.0) & (x["M_s"] <= 0.0)).any():
        found.append(("M_s", "M_s is 0 with an elastic stand; expected more than 0"))
    return found


fmu, kernel, ElasticJoint = derive(model, law, start)
