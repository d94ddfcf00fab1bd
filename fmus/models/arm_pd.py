"""PD coupling with gravity and friction compensated, for a serial arm: what leader arms run today.

For each joint, with the motion q_j, dq_j of the other arm as received (delayed)::

    tau = K_p (q_j - q) + K_d (dq_j - dq) + g(q) + F_c tanh(dq / v_c) + F_v dq + F_o

g(q) is that of the table, whose gravity may be 0; the last three terms compensate friction by a
measured model, with the arm's own velocity. They are off by default.

Condition: that of ``pd``: none guarantees stability with delay. A compensation of friction whose
slope at rest, F_v + F_c / v_c, exceeds the friction of the arm is negative damping: with K_d below
the difference, the arm vibrates although nothing is delayed.

Source: own construction; position-position coupling as in ``pd``. OpenArm's bilateral teleoperation
is this law with the gains of `configs/compare/openarm.toml`; it writes F_c tanh(0.1 k dq), so that
v_c = 10 / k.

Sampled: inputs are read at t_k, outputs are held to the next step. Each joint's torque is limited
to ±tau_max. The table is that of ``chain``; the options of a scenario are those of ``arm``.
"""

from __future__ import annotations

from fmus.arms import chain
from fmus.arms.joints import DAMPING, RATE, STIFFNESS, TORQUE, Joints, controller
from fmus.arms.robot import of_robot
from fmus.build.reference import Values, derive
from fmus.model import Model
from fmus.model.numeric import Array, np


def model(joints: int = 7) -> Model:
    """Declare the controller of an arm of `joints`, from 1 to 16. Raises FmuError for others."""
    arm = Joints(joints)
    table = chain.variables(arm)
    gains = (
        arm.gain("K_p", STIFFNESS, 10.0, "Stiffness of the coupling"),
        arm.gain("K_d", DAMPING, 1.0, "Damping of the coupling"),
        arm.gain("F_c", TORQUE, 0.0, "Compensated Coulomb friction"),
        arm.gain("v_c", RATE, 0.1, "Velocity at which 76 % of F_c are compensated", 1e-6),
        arm.gain("F_v", DAMPING, 0.0, "Compensated viscous friction"),
        arm.vector("F_o", "parameter", TORQUE, "Compensated constant torque"),
        arm.tau_max,
    )
    names = tuple(v.name for v in (*gains, *table))
    return controller(
        "arm_pd",
        "PD coupling of a serial arm with gravity and friction compensated",
        (
            arm.q_j,
            arm.dq_j,
            arm.torque(("q", "dq", "q_j", "dq_j"), names, elementwise=False),
            *gains,
            *table,
        ),
        (
            "chain.h",
            "chain_check.h",
            "limit.h",
            "trig.c",
            "hyperbolic.c",
            "hyperbolic.h",
        ),
        __doc__,
        joints=arm,
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Values:
    """The equation above, limited: tau (n,) N.m; `q`, `q_j` (n,) rad; `dq`, `dq_j` (n,) rad/s."""
    friction = x["F_c"] * np.tanh(dq / x["v_c"]) + x["F_v"] * dq + x["F_o"]
    spring = x["K_p"] * (q_j - q) + x["K_d"] * (dq_j - dq)
    still = np.zeros_like(q)
    wanted = spring + chain.inverse(chain.of_values(x), q, still, still) + friction
    return {"tau": np.clip(wanted, -x["tau_max"], x["tau_max"])}


def start(x: Values, q: Array, dq: Array, q_j: Array, dq_j: Array) -> Values:
    """Torque at the start, tau (n,) N.m, as `law`. Raises ScenarioError for a table of no arm."""
    chain.check(chain.of_values(x), "arm_pd")
    return law(x, 0.0, 0.0, q, dq, q_j, dq_j)


fmu, kernel, ArmPD = derive(model, law, start)
prepare = of_robot(model)
