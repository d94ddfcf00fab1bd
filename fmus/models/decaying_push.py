"""A slowly decaying push whose integral is unbounded, as a torque and as a force.

The paper's example, f = 1 / (t + 1), is square-integrable while its integral is unbounded::

    tau_h = tau_0 / (t / T + 1)      on an arm
    f     = f_0 / (t / T + 1)        on a point mass

Its norm is finite, ∫ f² dt = f_0² T, and its integral f_0 T ln (t / T + 1) grows without bound. A
bounded effort therefore moves a system whose output contains the integral of the input anywhere.

Source: the paper, Sec. III and Remark 5 (f = 1 / (t + 1)).

Sampled: the push of t_k is held to the next step. Outputs at the start are those of t = 0.
"""

from __future__ import annotations

from cosim.base.errors import RunError
from fmus.arms.joints import TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal, Variable


def model(joints: int = 2) -> Model:
    """Declare the push; by default 1 N.m on each of the `joints`, and 1 N, at t = 0, T = 1 s."""
    arm = Joints(joints)
    return Model(
        identifier="decaying_push",
        description="Push that decays as 1 / (t + 1)",
        kind="sampled",
        variables=(
            arm.signal("tau_h", TORQUE, "Torque on an arm", start_depends=("tau_0",)),
            Variable(
                "f",
                "output",
                (),
                "N",
                description="Force on a point mass",
                start_depends=("f_0",),
            ),
            arm.vector("tau_0", "parameter", TORQUE, "Torque at t = 0", 1.0),
            Variable("f_0", "parameter", (), "N", 1.0, "Force at t = 0"),
            Variable("T", "parameter", (), "s", 1.0, "When it is half of that", minimum=1e-6),
        ),
        sources=("decaying_push.c",),
        step=5e-3,
        terminals=(Terminal("push", ("tau_h", "f"), "Torque and force"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float) -> Values:
    """The equations above: tau_h (m,) N.m and f, N, at `t` (s). Raises RunError before t = -T."""
    slow = t / x["T"] + 1.0
    if not slow > 0.0:
        raise RunError(f"the time is {t:g} s, expected more than -T = {-x['T']:g} s", time=t)
    return {"tau_h": x["tau_0"] / slow, "f": x["f_0"] / slow}


fmu, kernel, DecayingPush = derive(model, law)
