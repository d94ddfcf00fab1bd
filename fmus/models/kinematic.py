"""The paper's coupling for a robot that takes velocities or positions, without a model of it.

With a ``servo`` that is fast against the coupling, the reference of the dynamic feedback itself is
the command, for one arm and its neighbours j::

    xi   = dq + alpha q                                                  sent, (47)
    dz   = -alpha dq + lambda_M (dq - z) + b tau_m - lambda Σ_j w_j (xi - xi_in_j)
    dq_c = z,   q_c = q(0) + ∫ dq_c dt

To a servo in velocity mode with the gain K_v and without an integral this is the paper's law with K
= K_v and theta_hat = 0, since tau = K_v (z - dq) = -K_v s. A person moves such an arm by what the
servo yields: s is about tau_h/K_v, so that the felt damping is that of Theorem 5 with this K. A
servo that yields nothing, because it has an integral or takes positions, is moved by a measured
force only: `tau_m` is the torque of the operator or of the environment on each joint, and `b`
(1/kg.m2) the admittance. A constant push tau_m of one of two arms then moves both at b tau_m/(alpha
(2 + lambda ΣT)).

Condition: what is stated holds for K_v/M of each joint 5 to 10 times the rates lambda + alpha, and
lambda_M + alpha; the delay of the servo, M/K_v, counts as part of the links' delay T.

Limits: dq_c and z keep within ±v_max. Where the servo says by `clamped` that it is limited, z does
not change further in that direction, and q_c moves with the arm.

Sampled: outputs as of t_k; z advances by one step of the explicit Euler method. `age_max` and
`age_fade` treat old signals as in ``teleoperation``.

Source: the paper, eqs (76)-(81), for inertia that the servo makes irrelevant: own construction. It
is not the law of arXiv 2106.12470.
"""

from __future__ import annotations

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from fmus.arms.adaptive_variables import coupling_gains, network_inputs
from fmus.arms.joints import RATE, TORQUE, Joints, rate
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np
from fmus.models import servo
from fmus.models.servo import UNLIMITED
from fmus.models.teleoperation import coupling


def model(joints: int = 7, neighbours: int = 1) -> Model:
    """Declare the controller of `joints` that receives xi from `neighbours` >= 1.

    Raises FmuError for a number of joints that is not a whole number of at least 1, and
    ScenarioError for less than one neighbour.
    """
    if neighbours < 1:
        raise ScenarioError(f"neighbours is {neighbours}, expected at least 1", "kinematic")
    arm = Joints(joints)
    admittance = "Admittance: acceleration by tau_m"
    return Model(
        identifier=f"kinematic_n{neighbours}" if neighbours > 1 else "kinematic",
        description="The paper's coupling as a command of velocity or position",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            *network_inputs(joints, neighbours),
            servo.command(arm, "tau_m", TORQUE, "Measured torque on the arm"),
            servo.command(arm, "clamped", "1", "1, -1 where the servo is limited, 0 elsewhere"),
            *commands(arm, (), ("z", "v_max")),
            arm.signal("xi", RATE, "Signal sent: dq + alpha q", ("q", "dq"), ("alpha",)),
            arm.signal("s", RATE, "Sliding vector: dq - z", ("dq",), ("z",)),
            arm.vector("z", "output", RATE, "State of the dynamic feedback", settable=True),
            rate("alpha", 0.5, "Gain of q in xi"),
            rate("lambda_M", 10.0, "Manipulability gain"),
            arm.gain("b", "1/kg.m2", 0.0, admittance),
            arm.gain("v_max", RATE, UNLIMITED, "Limit of the velocity"),
            *coupling_gains(),
            arm.local("z_next", RATE, "z of the next step"),
            arm.local("q_next", "rad", "q_c of the step before"),
        ),
        sources=("kinematic.c", "commands.h", "neighbours.h", "limit.h"),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq"), "Motion in"),
            Terminal("commands", ("q_c", "dq_c", "clamped"), "Commands out, whether limited in"),
            Terminal("network", ("xi", "xi_in", "w", "age"), "Signals of the neighbours"),
        ),
        documentation=__doc__ or "",
    )


def commands(
    arm: Joints,
    depends: tuple[str, ...],
    start_depends: tuple[str, ...],
    *,
    elementwise: bool = True,
) -> tuple[Variable, Variable]:
    """The outputs q_c, rad, and dq_c, rad/s; the arguments are those of dq_c."""
    measured = tuple(dict.fromkeys((*depends, "dq", "clamped")))
    q_c = arm.signal("q_c", "rad", "Commanded position", measured, ("q",))
    dq_c = arm.signal("dq_c", RATE, "Commanded velocity", depends, start_depends)
    return replace(q_c, elementwise=elementwise), replace(dq_c, elementwise=elementwise)


def start(x: Values, q: Array, dq: Array, *inputs: Array) -> Values:
    """At rest where the arm is, with z; `q` (n,) rad, `dq` (n,) rad/s. Raises ScenarioError."""
    if x["alpha"] <= 0:
        raise ScenarioError("alpha is 0, expected more than 0 with neighbours", "kinematic")
    z = np.clip(x["z"], -x["v_max"], x["v_max"])
    now = {"q_c": q, "dq_c": z, "xi": dq + x["alpha"] * q, "s": dq - z, "z": z}
    return now | {"z_next": z, "q_next": q}


def law(
    x: Values,
    t: float,
    h: float,
    q: Array,
    dq: Array,
    xi_in: Array,
    w: Array,
    age: Array,
    tau_m: Array,
    clamped: Array,
) -> Values:
    """The equations above: dq_c (n,) rad/s and q_c (n,) rad; z advances to t + h, s.

    `q` (n,) rad, `dq` (n,) rad/s, `tau_m` (n,) N.m, `clamped` (n,); `xi_in` (k, n) rad/s, `w` (k,)
    without a unit and `age` (k,) s of k neighbours.
    """
    z = x["z_next"]
    xi = dq + x["alpha"] * q
    pull, _ = coupling(x, xi, xi_in, w, age)
    dz = -x["alpha"] * dq + x["lambda_M"] * (dq - z) + x["b"] * tau_m - pull
    return {"xi": xi, "s": dq - z, "z": z} | advanced(x, h, dq, z, z, dz, clamped)


def advanced(
    x: Values, h: float, dq: Array, dq_c: Array, z: Array, dz: Array, clamped: Array
) -> Values:
    """The commands, and z and q_c a step h, s, later; all (n,): rad/s, dz rad/s2.

    Where `clamped`, z changes in the other direction only, and q_c follows the arm.
    """
    allowed = np.clip(dq_c, -x["v_max"], x["v_max"])
    moved = np.where(clamped * (allowed - dq) > 0.0, dq, allowed)
    change = np.where(clamped * dz > 0.0, 0.0, dz)
    q_c = x["q_next"] + h * moved
    z_next = np.clip(z + h * change, -x["v_max"], x["v_max"])
    return {"q_c": q_c, "dq_c": allowed, "z_next": z_next, "q_next": q_c}


fmu, kernel, Kinematic = derive(model, law, start)
