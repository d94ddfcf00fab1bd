"""The signal that the controllers exchange, computed next to the robot.

For each joint::

    xi = dq + alpha q

Source: the paper, eq. (47).

Sampled: inputs are read at t_k, outputs are held to the next step. ``teleoperation`` has the same
output. This component depends on the robot only, so that two controllers can exchange its signal
without delay and without an algebraic loop. `alpha` must equal that of the controller.
"""

from __future__ import annotations

from fmus.arms.joints import RATE, Joints, rate
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array


def model(joints: int = 2) -> Model:
    """Declare the signal of an arm of `joints`; the default of alpha is Sec. VII-C's."""
    arm = Joints(joints)
    return Model(
        identifier="xi",
        description="Signal xi = dq + alpha q exchanged by the controllers",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            arm.signal("xi", RATE, "Signal sent: dq + alpha q", ("q", "dq"), ("alpha",)),
            rate("alpha", 0.5, "Gain of q"),
        ),
        sources=("xi.c",),
        step=5e-3,
        terminals=(Terminal("joints", ("q", "dq", "xi"), "Motion in, signal out"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, q: Array, dq: Array) -> Values:
    """The equation above: xi (m,) rad/s of `q`, `dq` (m,) rad, rad/s."""
    return {"xi": dq + x["alpha"] * q}


fmu, kernel, Xi = derive(model, law)
