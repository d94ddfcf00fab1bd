"""A hand that holds the tip of a serial arm, and a wall in its way.

For the tip x(q) of any chain (``chain``), in the frame of its base, with J = dx/dq::

    f_h     = grip (K_h (x_h - x) + B_h (dx_h - J dq))          force of the hand on the tip
    f_e     = n max(0, k_w d + b_w n'J dq)  for d > 0           force of the tip on the wall
    tau_ext = J'(f_h - f_e),   d = n'(x - x_w)

x_h is the place that the hand wants, and `grip` releases (0) or holds (1) the tip; without K_h and
B_h there is no hand. The wall is a plane through x_w without friction; its normal n points into it.
Without k_w there is none. Feed tau_ext to the input `tau_ext` of the arm.

Typical values of a human hand are K_h from 50 N/m (relaxed) to 500 N/m (tight) and B_h from 5 to
20 N.s/m, as in ``endpoint_operator``, which is this hand for the planar arm. What is in the hand or
the hand itself has a mass: `options.payload` of the arm.

Source: own construction; the torque of a force at a point is J' times the force.

Sampled: inputs are read at t_k, outputs are held to the next step. A stiff wall therefore needs a
short period h: b_w > k_w h / 2 (J. E. Colgate, G. Schenkel, "Passivity of a class of sampled-data
systems", J. Robotic Systems 14(1), 1997).
"""

from __future__ import annotations

from fmus.arms import chain, task_space
from fmus.arms.joints import TORQUE, Joints
from fmus.arms.robot import of_robot
from fmus.build.reference import Values, derive
from fmus.model import Causality, Model, Terminal, Variable
from fmus.model.numeric import Array, np

_HAND = ("x_h", "dx_h", "grip")


def model(joints: int = 7) -> Model:
    """Declare hand and wall for an arm of `joints`, from 1 to 16. Raises FmuError for others."""
    arm = Joints(joints)
    table = chain.variables(arm)
    place = ("joint_type", "rotation", "origin", "tip")
    hand, wall = ("K_h", "B_h"), ("k_w", "b_w", "x_w", "normal")
    return Model(
        identifier="arm_tip",
        description="A hand and a wall at the tip of a serial arm",
        kind="sampled",
        variables=(
            arm.q,
            arm.dq,
            _vector("x_h", "input", "m", "Place the hand wants"),
            Variable(
                *("dx_h", "input", (3,), "m/s", 0.0, "Velocity of the place it wants"),
                optional=True,
            ),
            Variable(
                *("grip", "input", (), "1", 1.0, "Scale of the hand: 0 released, 1 held"),
                optional=True,
            ),
            Variable(
                *("tau_ext", "output", (joints,), TORQUE, 0.0, "Torque on the robot"),
                depends=("q", "dq", *_HAND),
                start_depends=(*place, *hand, *wall),
            ),
            _output("x", "m", "Place of the tip", ("q",), place),
            _output("f_h", "N", "Force of the hand on the tip", ("q", "dq", *_HAND), place + hand),
            _output("f_e", "N", "Force of the tip on the wall", ("q", "dq"), place + wall),
            _vector("K_h", "parameter", "N/m", "Stiffness of the hand", 0.0, 0.0),
            _vector("B_h", "parameter", "N.s/m", "Damping of the hand", 0.0, 0.0),
            Variable("k_w", "parameter", (), "N/m", 0.0, "Stiffness of the wall", minimum=0.0),
            Variable("b_w", "parameter", (), "N.s/m", 0.0, "Damping of the wall", minimum=0.0),
            _vector("x_w", "parameter", "m", "A point of the wall's surface"),
            Variable(
                *("normal", "parameter", (3,), "1", (1.0, 0.0, 0.0)), "Unit vector into the wall"
            ),
            _vector("tip", "parameter", "m", "Tip in the frame of the last link"),
            *table,
        ),
        sources=(
            *("arm_tip.c", "chain.h", "chain_check.h", "chain_tip.h"),
            *("contact.c", "contact.h", "trig.c"),
        ),
        step=1e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau_ext"), "Motion in, torque out"),
            Terminal("tip", ("x_h", "dx_h", "x", "f_h", "f_e"), "Target, place and forces"),
        ),
        documentation=__doc__ or "",
    )


def _vector(
    name: str,
    causality: Causality,
    unit: str,
    text: str,
    start: float = 0.0,
    minimum: float | None = None,
) -> Variable:
    return Variable(name, causality, (3,), unit, start, text, minimum=minimum)


def _output(
    name: str, unit: str, text: str, depends: tuple[str, ...], start_depends: tuple[str, ...]
) -> Variable:
    return Variable(
        name, "output", (3,), unit, 0.0, text, depends=depends, start_depends=start_depends
    )


def law(
    x: Values, t: float, h: float, q: Array, dq: Array, x_h: Array, dx_h: Array, grip: Array
) -> Values:
    """The equations above: tau_ext (n,) N.m; place x (3,) m, forces f_h and f_e (3,) N.

    `q`, `dq` (n,) rad, rad/s; `x_h`, `dx_h` (3,) m, m/s; `grip` scalar, 0 to 1.
    """
    table, n = chain.of_values(x), x["normal"]
    at, J = task_space.tip(table, x["tip"], q), task_space.jacobian(table, x["tip"], q)
    dx = J @ dq
    f_h = grip * (x["K_h"] * (x_h - at) + x["B_h"] * (dx_h - dx))
    depth = n @ (at - x["x_w"])
    push = x["k_w"] * depth + x["b_w"] * (n @ dx)
    f_e = n * np.where(depth > 0.0, np.maximum(0.0, push), 0.0)
    return {"tau_ext": J.T @ (f_h - f_e), "x": at, "f_h": f_h, "f_e": f_e}


def start(x: Values, q: Array, dq: Array, x_h: Array, dx_h: Array, grip: Array) -> Values:
    """Outputs at the start, (n,) and (3,), as `law`. Raises ScenarioError for a table of no arm."""
    chain.check(chain.of_values(x), "arm_tip")
    return law(x, 0.0, 0.0, q, dq, x_h, dx_h, grip)


fmu, kernel, ArmTip = derive(model, law, start)
prepare = of_robot(model)
