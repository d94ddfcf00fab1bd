"""Friction of each joint, viscous and dry, as a torque on an arm that has none of its own.

The torque on the arm is::

    tau = -damping dq - friction tanh(dq / v_f)

Dry (Coulomb) friction is smooth here: it reaches 76 % at the velocity v_f. Near rest it acts as a
viscous friction of friction / v_f, so that an arm creeps where dry friction would hold it. Connect
the output to the input `tau_ext` of the arm. The torque is held over a step h, which must be short:
h (damping + friction / v_f) must be well below the least inertia of the arm.

Source: the friction term of ``fmus.models.arm``; B. Armstrong-Hélouvry, P. Dupont, C. Canudas de
Wit, "A survey of models, analysis tools and compensation methods for the control of machines with
friction", Automatica 30(7), 1994.

Sampled: inputs are read at t_k, outputs are held to the next step.
"""

from __future__ import annotations

from fmus.arms.joints import DAMPING, RATE, TORQUE, Joints
from fmus.build.reference import Values, derive
from fmus.model import Model, Terminal
from fmus.model.numeric import Array, np

#: ``joint``: constructed values for a joint of an arm with torques of some 10 N.m.
PRESETS: dict[str, dict[str, float]] = {"joint": {"damping": 0.5, "friction": 1.0, "v_f": 0.05}}


def model(joints: int = 2) -> Model:
    """Declare the friction of an arm of `joints`; by default there is none."""
    arm = Joints(joints)
    gains = ("damping", "friction", "v_f")
    return Model(
        identifier="friction",
        description="Viscous and smooth dry friction of each joint",
        kind="sampled",
        variables=(
            arm.dq,
            arm.signal("tau", TORQUE, "Torque of the friction on the arm", ("dq",), gains),
            arm.gain("damping", DAMPING, 0.0, "Viscous friction"),
            arm.gain("friction", TORQUE, 0.0, "Dry friction"),
            arm.gain("v_f", RATE, 0.1, "Velocity at which 76 % of the dry friction act", 1e-6),
        ),
        sources=("friction.c", "hyperbolic.c", "hyperbolic.h"),
        step=1e-3,
        terminals=(Terminal("joints", ("dq", "tau"), "Velocity in, torque out"),),
        documentation=__doc__ or "",
    )


def law(x: Values, t: float, h: float, dq: Array) -> Values:
    """The equation above: tau (m,) N.m of `dq` (m,) rad/s; `t`, `h` in s are not used."""
    return {"tau": -x["damping"] * dq - x["friction"] * np.tanh(dq / x["v_f"])}


fmu, kernel, Friction = derive(model, law)
