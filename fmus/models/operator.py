"""Operator: a hand that holds the robot with a spring and a damper.

The torque of the operator on the robot is a PD action, for each joint::

    tau_h = -k_d dq - k_p (q - q_h)

Source: the paper, Sec. VII (standard PD action).

Sampled: inputs are read at t_k, outputs are held to the next step. ``planar2r`` contains the same
law, evaluated at every stage of its integrator, for grips too stiff for the communication step.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, STIFFNESS, TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array


def model(joints: int = 2) -> Model:
    """Declare the operator of an arm of `joints`; the defaults are Sec. VII: k_p 10, k_d 5.

    q_h is (3.5, 3) rad by default, and 0 for another number of joints than two.
    """
    arm = Joints(joints)
    return Model(
        identifier="operator",
        description="Operator holding the robot with a spring and a damper",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            arm.signal(
                "tau_h",
                TORQUE,
                "Torque of the operator on the robot",
                ("q", "dq"),
                ("k_p", "k_d", "q_h"),
            ),
            arm.gain("k_p", STIFFNESS, 10.0, "Stiffness"),
            arm.gain("k_d", DAMPING, 5.0, "Damping"),
            arm.vector("q_h", "parameter", "rad", "Position the operator wants", (3.5, 3.0)),
        ),
        sources=("operator.c",),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau_h"), "Motion in, torque out"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array) -> Values:
    """The equation above: tau_h (m,) N.m of `q`, `dq` (m,) rad, rad/s."""
    return {"tau_h": -x["k_d"] * dq - x["k_p"] * (q - x["q_h"])}


fmu, kernel, Operator = derive(model, law)
