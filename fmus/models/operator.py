"""Operator: a hand that holds the robot with a spring and a damper.

The standard PD action of the paper's Sec. VII, torque on the robot, of each joint::

    tau_h = -k_d dq - k_p (q - q_h)

Sampled: read at t_k, held to the next step. The same law is inside ``planar2r``, solved at the rate
of its integrator, for grips too stiff for the communication step.
"""

from __future__ import annotations

from cosim.component import Kind
from fmus.model import Model, Terminal, Variable

_KIND: Kind = "sampled"


def model() -> Model:
    """Declare the operator; the defaults are Sec. VII: k_p 10, k_d 5, q_h (3.5, 3)."""
    torque, stiffness, damping = "N.m", "N.m/rad", "N.m.s/rad"
    return Model(
        identifier="operator",
        description="Operator holding the robot with a spring and a damper",
        kind=_KIND,
        variables=(
            Variable("q", "input", (2,), "rad", description="Joint position"),
            Variable("dq", "input", (2,), "rad/s", description="Joint velocity"),
            Variable(
                "tau_h",
                "output",
                (2,),
                torque,
                description="Torque of the operator on the robot",
                depends=("q", "dq"),
                elementwise=True,
            ),
            Variable("k_p", "parameter", (2,), stiffness, 10.0, "Stiffness", minimum=0.0),
            Variable("k_d", "parameter", (2,), damping, 5.0, "Damping", minimum=0.0),
            Variable("q_h", "parameter", (2,), "rad", (3.5, 3.0), "Position the operator wants"),
        ),
        sources=("operator.c",),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "tau_h"), "Motion in, torque out"),),
        documentation=__doc__ or "",
    )
