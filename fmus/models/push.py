"""A constant push, as a torque on an arm and as a force on a point mass::

    tau_h = tau_p,   f = f_p    for t_0 <= t < t_1
    tau_h = 0,       f = 0      otherwise

The closed forms assume this input: an arm under the paper's law drifts at lambda_M tau_p /
(K alpha), and a pair of arms at lambda_M tau_p / (K alpha (2 + lambda (T_12 + T_21))).

Source: own construction; the velocities are the closed form O4 of docs/paper.md.

Sampled: the push of t_k is held to the next step; a step that begins less than a millionth of its
length before t_0 or t_1 counts as beginning at that time. Outputs at the start are those of t = 0.
"""

from __future__ import annotations

from fmus.arms.joints import TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable

_NEVER = 1e9  # s


def model(joints: int = 2) -> Model:
    """Declare the push; by default 1 N.m on each of the `joints`, and 1 N, without end."""
    arm = Joints(joints)
    return Model(
        identifier="push",
        description="Constant push for a time",
        kind="sampled",
        variables=(
            arm.signal("tau_h", TORQUE, "Torque on an arm", start_depends=("tau_p", "t_0")),
            Variable(
                "f",
                "output",
                (),
                "N",
                description="Force on a point mass",
                start_depends=("f_p", "t_0"),
            ),
            arm.vector("tau_p", "parameter", TORQUE, "Torque while it pushes", 1.0),
            Variable("f_p", "parameter", (), "N", 1.0, "Force while it pushes"),
            Variable("t_0", "parameter", (), "s", 0.0, "When it begins", minimum=0.0),
            Variable("t_1", "parameter", (), "s", _NEVER, "When it ends", minimum=1e-9),
        ),
        sources=("push.c", "schedule.h"),
        step=5e-3,
        terminals=(Terminal("push", ("tau_h", "f"), "Torque and force"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float) -> Values:
    """The equations above: tau_h (m,) N.m and f, N, at `t` (s)."""
    on = float(x["t_0"] <= t + 1e-6 * h < x["t_1"])
    return {"tau_h": on * x["tau_p"], "f": on * x["f_p"]}


fmu, kernel, Push = derive(model, law)
