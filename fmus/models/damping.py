"""Damping with gravity compensation: the simplest controller that lets an operator lead an arm.

The paper calls the damping d alpha in this equation; everywhere else its alpha is a rate in 1/s::

    tau = -d dq + g(q)

    g = [ γ1 cos q1 + γ2 cos (q1 + q2) ]     theta_g = (γ1, γ2), N.m, the controller's values
        [ γ2 cos (q1 + q2)             ]

If g is the true gravity of the arm, M ddq + C dq = -d dq + tau_h. Under a constant push the
velocity of a joint tends to tau_h / d, and the L2 norm of dq is at most that of tau_h divided by
the least d. From tau_h to q there is one more pure integral, so the arm is infinitely manipulable
with degree one.

Source: the paper, eq. (24), Theorem 1.

Sampled: inputs are read at t_k, outputs are held to the next step.
"""

from __future__ import annotations

from fmus.arms.dynamics import gravity
from fmus.arms.joints import DAMPING, DQ, TORQUE, Q, gain
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array


def model() -> Model:
    """Declare the controller; by default d is 5 N.m.s/rad and the arm horizontal."""
    return Model(
        identifier="damping",
        description="Damping with gravity compensation",
        kind="sampled",
        variables=(
            Q,
            DQ,
            Variable(
                "tau",
                "output",
                (2,),
                TORQUE,
                description="Control torque",
                depends=("q", "dq"),
                start_depends=("d", "theta_g"),
            ),
            gain("d", DAMPING, 5.0, "Damping of each joint"),
            Variable("theta_g", "parameter", (2,), TORQUE, 0.0, "Known gravity parameters"),
        ),
        sources=("damping.c", "trig.c"),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau"), "Motion in, torque out"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array) -> Values:
    """The equation above: tau (m,) N.m of `q`, `dq` (m,) rad, rad/s; `t`, `h` in s are not used."""
    return {"tau": -x["d"] * dq + gravity(x["theta_g"], q)}


fmu, kernel, Damping = derive(model, law)
