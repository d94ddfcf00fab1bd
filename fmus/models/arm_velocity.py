"""Adaptive law for a serial arm that takes velocities, whose servos have unknown gains.

To a ``servo`` in velocity mode, tau = K_v (dq_c - dq) with an unknown K_v of each joint, the law of
``arm_teleoperation`` is::

    dz   = -alpha dq + lambda_M (dq - z) - lambda Σ_j w_j (xi - xi_in_j),   xi = dq + alpha q
    s    = dq - z
    dq_c = z + Y_i(q, dq, z, dz) theta_hat_i + own_hat_i · (dz, z)_i           for each joint i
    dtheta_hat_i = -Gamma_row_i Gamma Y_i' s_i,   down_hat_i = -Gamma_own (dz, z)_i s_i

Y_i is row i of the regressor of ``chain_law``. Each row has a copy of its own of the parameters of
the links, theta_hat_i = theta/K_v,i (n, 10), since each servo divides them by another gain; so has
`own_hat` of each joint what acts on it alone: its rotor's inertia over K_v,i (s), and its viscous
friction over K_v,i. Then, with the error of row i in theta_tilde_i::

    M ds/dt + C s = -K_v s + K_v (Y_i theta_tilde_i) + tau_h - friction of s
    V = ½ s' M s + ½ Σ_i K_v,i |theta_tilde_i|² in Gamma_i⁻¹,   dV/dt = -s' K_v s + s' tau_h

so that Theorems 2 to 5 hold with K = K_v, whatever it is. The parameters of links before joint i do
not act on row i and stay.

The servo must have no integral (K_p = 0), which would hold against the person who pushes, and no
limit that acts: where `clamped` says that one does, no estimate changes, z changes in the other
direction only, and q_c follows the arm. `gravity` says whether the robot's own controller
compensates gravity (0) or theta_hat adapts it (2); a torque for it cannot be commanded. Gamma has
an entry for each parameter of a link; Gamma_row is about one over the K_v that is guessed, for
gains that act like those of ``arm_teleoperation``.

Sampled: outputs as of t_k; z and the estimates advance by one step of the explicit Euler method.
The table is that of ``chain``, of which inertia and rotors are not used; for ``planar2r`` it is two
joints with the `origin` (0, 0, 0) and (1, 0, 0), the length of its first link in m.

Source: the paper's law with the parameters of each row scaled by the gain of its servo, own
construction; it is not the law of arXiv 2106.12470. The idea of keeping the inner loop and adapting
to its gains: H. Wang, W. Ren, C. C. Cheah, Y. Xie, S. Lyu, arXiv 1603.05557.
"""

from __future__ import annotations

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from fmus.arms import chain, serial_arm
from fmus.arms.adaptive_variables import ADAPTED, coupling_gains, network_inputs
from fmus.arms.chain_law import regressor
from fmus.arms.joints import RATE, Joints, rate
from fmus.arms.robot import of_robot
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np
from fmus.models import servo
from fmus.models.kinematic import advanced, commands
from fmus.models.servo import UNLIMITED
from fmus.models.teleoperation import coupling

_GRAVITY = "Gravity: 0 none, or compensated by the robot's controller; 2 adapted in theta_hat"
_OWN = "Estimate of the rotor's inertia over K_v (s), and of the viscous friction over K_v"


def model(joints: int = 7, neighbours: int = 1) -> Model:
    """Declare the controller of an arm of `joints` that receives xi from `neighbours` >= 1.

    Raises FmuError for a number of joints that is not a whole number from 1 to 16, and
    ScenarioError for less than one neighbour.
    """
    if neighbours < 1:
        raise ScenarioError(f"neighbours is {neighbours}, expected at least 1", "arm_velocity")
    arm = Joints(joints)
    motion = ("q", "dq", "xi_in", "w", "age")
    return Model(
        identifier=f"arm_velocity_n{neighbours}" if neighbours > 1 else "arm_velocity",
        description="Adaptive controller of a serial arm that takes velocities",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            *network_inputs(joints, neighbours),
            servo.command(arm, "clamped", "1", "1, -1 where the servo is limited, 0 elsewhere"),
            *commands(arm, motion, ("z", "v_max"), elementwise=False),
            arm.signal("xi", RATE, "Signal sent: dq + alpha q", ("q", "dq"), ("alpha",)),
            arm.signal("s", RATE, "Sliding vector: dq - z", ("dq",), ("z",)),
            arm.vector("z", "output", RATE, "State of the dynamic feedback", settable=True),
            *_estimates(arm),
            rate("alpha", 0.5, "Gain of q in xi"),
            rate("lambda_M", 10.0, "Manipulability gain"),
            serial_arm.adaptation(arm),
            *_rates(arm),
            arm.gain("v_max", RATE, UNLIMITED, "Limit of the velocity"),
            replace(serial_arm.gravity(), start=0.0, description=_GRAVITY),
            *coupling_gains(),
            *chain.variables(arm),
            arm.local("z_next", RATE, "z of the next step"),
            arm.local("q_next", "rad", "q_c of the step before"),
        ),
        sources=("arm_velocity.c", "commands.h", "neighbours.h", *serial_arm.SOURCES),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq"), "Motion in"),
            Terminal("commands", ("q_c", "dq_c", "clamped"), "Commands out, whether limited in"),
            Terminal("network", ("xi", "xi_in", "w", "age"), "Signals of the neighbours"),
        ),
        documentation=__doc__ or "",
    )


def _estimates(arm: Joints) -> tuple[Variable, ...]:
    n = arm.count
    text = "Estimate of the parameters of each link over K_v, a copy for each joint"
    return (
        Variable("theta_hat", "output", (n, n, 10), "1", description=text, settable=True),
        Variable("own_hat", "output", (n, 2), "1", description=_OWN, settable=True),
        Variable("theta_hat_next", "local", (n, n, 10), "1", description="theta_hat of the next"),
        Variable("own_hat_next", "local", (n, 2), "1", description="own_hat of the next step"),
    )


def _rates(arm: Joints) -> tuple[Variable, ...]:
    own = (0.1, 0.1) * arm.count
    return (
        arm.gain("Gamma_row", "1", 0.1, "Factor of Gamma for the copy of each joint"),
        Variable(
            *("Gamma_own", "parameter", (arm.count, 2), "1", own, "Adaptation gain of own_hat"),
            minimum=0.0,
        ),
    )


def start(x: Values, q: Array, dq: Array, *inputs: Array) -> Values:
    """At rest where the arm is, with z and the estimates; `q` (n,) rad, `dq` (n,) rad/s.

    Raises ScenarioError for a table of no arm, and for what cannot be commanded.
    """
    chain.check(chain.of_values(x), "arm_velocity")
    if x["alpha"] <= 0:
        raise ScenarioError("alpha is 0, expected more than 0 with neighbours", "arm_velocity")
    if x["gravity"] not in (0.0, ADAPTED):
        raise ScenarioError(
            "gravity is 1, but a torque against it cannot be commanded; expected 0 or 2",
            "arm_velocity.gravity",
        )
    z = np.clip(x["z"], -x["v_max"], x["v_max"])
    now = {"q_c": q, "dq_c": z, "xi": dq + x["alpha"] * q, "s": dq - z, "z": z}
    estimates = {"theta_hat_next": x["theta_hat"], "own_hat_next": x["own_hat"]}
    given = {name: x[name] for name in ("theta_hat", "own_hat")}
    return now | given | estimates | {"z_next": z, "q_next": q}


def law(
    x: Values, t: float, h: float, q: Array, dq: Array, xi_in: Array, w: Array, age: Array,
    clamped: Array,
) -> Values:  # fmt: skip
    """The equations above: dq_c (n,) rad/s and q_c (n,) rad; z and estimates advance to t + h, s.

    `q` (n,) rad, `dq` (n,) rad/s, `clamped` (n,); `xi_in` (k, n) rad/s, `w` (k,) without a unit and
    `age` (k,) s of k neighbours.
    """
    z, theta_hat, own_hat = x["z_next"], x["theta_hat_next"], x["own_hat_next"]
    xi = dq + x["alpha"] * q
    pull, stale = coupling(x, xi, xi_in, w, age)
    s = dq - z
    dz = -x["alpha"] * dq + x["lambda_M"] * s - pull
    table = chain.of_values(x)
    Y = regressor(table, q, dq, z, dz, table.g if x["gravity"] == ADAPTED else np.zeros(3))
    own = np.stack([dz, z], axis=1)
    dq_c = z + np.einsum("ijk,ijk->i", Y, theta_hat) + (own * own_hat).sum(axis=1)
    now = {"xi": xi, "s": s, "z": z, "theta_hat": theta_hat, "own_hat": own_hat}
    moved = advanced(x, h, dq, dq_c, z, dz, clamped)
    if not (stale or clamped.any() or (moved["dq_c"] != dq_c).any()):
        rows = (x["Gamma_row"] * s)[:, None, None] * x["Gamma"]
        theta_hat = theta_hat - h * rows * Y
        own_hat = own_hat - h * x["Gamma_own"] * own * s[:, None]
    return now | moved | {"theta_hat_next": theta_hat, "own_hat_next": own_hat}


fmu, kernel, ArmVelocity = derive(model, law, start)
prepare = of_robot(model)
