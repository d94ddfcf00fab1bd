"""Target of a hand that moves from one position to another with minimum jerk.

For the joints q_h moves from q_0 to q_f, and for the endpoint x_h likewise from x_0 to x_f::

    q_h  = q_0 + (q_f - q_0) (10 p³ - 15 p⁴ + 6 p⁵)      p = (t - t_0) / T, from 0 to 1
    dq_h = (q_f - q_0) 30 p² (1 - p)² / T

This polynomial of degree five starts and ends at rest and without acceleration, and has the least
∫ |d³q/dt³|² dt of all such paths. A target exerts no torque. It moves an arm when it is wired to
``pd`` (as q_j, dq_j), to the grip inside ``planar2r`` (as q_h) or to ``endpoint_operator``.

Source: T. Flash, N. Hogan, "The coordination of arm movements: an experimentally confirmed
mathematical model", J. Neuroscience 5(7), 1985.

Sampled: the target of t_k is held to the next step. Outputs at the start are those of t = 0.
"""

from __future__ import annotations

from fmus.arms.joints import PLANAR, RATE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import np


def model(joints: int = 2) -> Model:
    """Declare the target of an arm of `joints`; by default it takes 5 s from t = 0.

    With two joints it goes from 0 to Sec. VII's q_h; otherwise q_f, too, is 0 by default.
    """
    arm = Joints(joints)
    return Model(
        identifier="minimum_jerk",
        description="Target that moves with the least jerk",
        kind="sampled",
        variables=(
            arm.signal("q_h", "rad", "Joint position wanted", start_depends=("q_0",)),
            arm.signal("dq_h", RATE, "Joint velocity wanted"),
            PLANAR.signal("x_h", "m", "Endpoint wanted", start_depends=("x_0",)),
            PLANAR.signal("dx_h", "m/s", "Velocity of the endpoint wanted"),
            arm.vector("q_0", "parameter", "rad", "Joint position before"),
            arm.vector("q_f", "parameter", "rad", "Joint position after", (3.5, 3.0)),
            PLANAR.vector("x_0", "parameter", "m", "Endpoint before", (2.0, 0.0)),
            PLANAR.vector("x_f", "parameter", "m", "Endpoint after", (0.0, 1.0)),
            Variable("t_0", "parameter", (), "s", 0.0, "When it begins", minimum=0.0),
            Variable("T", "parameter", (), "s", 5.0, "How long it takes", minimum=1e-6),
        ),
        sources=("minimum_jerk.c",),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q_h", "dq_h"), "Target of the joints"),
            Terminal("endpoint", ("x_h", "dx_h"), "Target of the endpoint"),
        ),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float) -> Values:
    """The equations above at `t` (s): q_h, rad, x_h, m, and their rates, 1/s; each (m,) or (2,)."""
    p = np.clip((t - x["t_0"]) / x["T"], 0.0, 1.0)
    part, speed = 10 * p**3 - 15 * p**4 + 6 * p**5, 30 * p**2 * (1 - p) ** 2 / x["T"]
    way_q, way_x = x["q_f"] - x["q_0"], x["x_f"] - x["x_0"]
    return {
        "q_h": x["q_0"] + way_q * part,
        "dq_h": way_q * speed,
        "x_h": x["x_0"] + way_x * part,
        "dx_h": way_x * speed,
    }


fmu, kernel, MinimumJerk = derive(model, law)
