"""The common part of the plants of arms: ports, the operator's grip and the wall inside them.

Of n joints, with the names of the variables that :func:`plant` declares::

    tau_h = grip (-k_d dq - k_p (q - q_h))                torque of the operator on the robot

    tau_e = max(0, k_w x + b_w dq)         contact = 0    torque of the robot on its environment
            max(0, x (k_w + b_w dq))                 1    at the depth x = q - q_w > 0 beyond the
            max(0, x^1.5 (k_w + b_w dq))             2    wall; 0 for x <= 0

Source: the paper, eqs (74), (75); K. H. Hunt, F. R. E. Crossley, "Coefficient of restitution
interpreted as damping in vibroimpact", J. Applied Mechanics 42(2), 1975.
"""

from __future__ import annotations

from collections.abc import Callable

from cosim.base.copies import replace
from fmus.arms.joints import DAMPING, RATE, STIFFNESS, TORQUE, Joints
from fmus.build.reference import Values
from fmus.model import Model, Terminal, Variable
from fmus.model.numeric import Array, np

TERMINALS = (
    Terminal("joints", ("tau", "q", "dq"), "Torque in, position and velocity out"),
    Terminal("hand", ("q_h", "grip", "tau_h"), "The operator's hand"),
)


def plant(
    identifier: str,
    description: str,
    arm: Joints,
    parameters: tuple[Variable, ...],
    sources: tuple[str, ...],
    documentation: str | None,
    *,
    lanes: bool = False,
) -> Model:
    """A plant of an `arm`: ports, its own `parameters`, and grip and wall."""
    return Model(
        identifier=identifier,
        description=f"{description}, operator's grip and wall inside",
        kind="continuous",
        variables=(*ports(arm), *parameters, *_parameters(arm)),
        sources=(*sources, "environment.h", "contact.c", "contact.h", "trig.c"),
        step=1e-3,
        terminals=TERMINALS,
        documentation=documentation or "",
        lanes=lanes,
        states=(("q", "dq"), ("dq", "ddq")),
        rates=(arm.vector("ddq", "local", "rad/s2", "Joint acceleration"),),
    )


def ports(arm: Joints) -> tuple[Variable, ...]:
    """Inputs and outputs: torques and the operator's hand in, motion and contact torques out."""
    return (
        arm.input("tau", TORQUE, "Control torque"),
        replace(arm.input("tau_ext", TORQUE, "External torque fed in"), optional=True),
        replace(arm.input("q_h", "rad", "Position the operator wants"), optional=True),
        Variable(
            *("grip", "input", (), "1", 1.0, "Scale of the grip: 0 released, 1 held"), optional=True
        ),
        arm.vector("q", "output", "rad", "Joint position", settable=True),
        arm.vector("dq", "output", RATE, "Joint velocity", settable=True),
        arm.signal(
            "tau_h",
            TORQUE,
            "Torque of the operator on the robot",
            ("q_h", "grip"),
            ("q", "dq", "k_p", "k_d"),
        ),
        arm.signal(
            "tau_e",
            TORQUE,
            "Torque of the robot on its environment",
            start_depends=("q", "dq", "k_w", "b_w", "q_w", "contact"),
        ),
    )


def _parameters(arm: Joints) -> tuple[Variable, ...]:
    """Parameters of grip, wall and integrator; grip and wall are off by default."""
    return (
        arm.gain("k_p", STIFFNESS, 0.0, "Stiffness of the grip"),
        arm.gain("k_d", DAMPING, 0.0, "Damping of the grip"),
        arm.gain("k_w", STIFFNESS, 0.0, "Stiffness of the wall"),
        arm.gain("b_w", DAMPING, 0.0, "Damping of the wall"),
        arm.vector("q_w", "parameter", "rad", "Position of the wall"),
        Variable(
            "contact",
            "parameter",
            start=0.0,
            description="Law of the wall: 0 spring-damper, 1 Hunt-Crossley n = 1, 2 n = 1.5",
            type="integer",
            minimum=0.0,
            maximum=2.0,
        ),
        Variable(
            "substeps",
            "parameter",
            start=1.0,
            description="Integrator steps in a communication step",
            type="integer",
            minimum=1.0,
        ),
    )


def grip_torque(x: Values, q: Array, dq: Array, q_h: Array, grip: Array) -> Array:
    """tau_h (n,), N.m, of q, q_h (n,) rad, dq (n,) rad/s and the scale `grip`, a scalar 0 to 1."""
    return grip * (-x["k_d"] * dq - x["k_p"] * (q - q_h))


def wall_torque(x: Values, q: Array, dq: Array) -> Array:
    """tau_e (n,), N.m, of q (n,) rad and dq (n,) rad/s."""
    k_w, b_w, contact = x["k_w"], x["b_w"], int(x["contact"])
    depth = np.maximum(0.0, q - x["q_w"])
    if contact == 0:
        torque = k_w * depth + b_w * dq
    else:
        torque = (depth if contact == 1 else depth * np.sqrt(depth)) * (k_w + b_w * dq)
    return np.where(depth > 0, np.maximum(0.0, torque), 0.0)


def outputs_at(x: Values, q: Array, dq: Array, q_h: Array, grip: Array) -> Values:
    """All outputs at a position q (n,) rad and velocity dq (n,) rad/s; `grip` a scalar 0 to 1."""
    tau_h, tau_e = grip_torque(x, q, dq, q_h, grip), wall_torque(x, q, dq)
    return {"q": q, "dq": dq, "tau_h": tau_h, "tau_e": tau_e}


def integrate(
    x: Values, acceleration: Callable[[Array, Array], Array], h: float, steps: int = 0
) -> tuple[Array, Array]:
    """(q, dq), (n,) rad and rad/s, a time h (s) after x's, in `steps` Runge-Kutta steps.

    `acceleration` gives ddq (n,), rad/s2, of q and dq; 0 steps stand for the parameter `substeps`.
    """
    steps = steps or int(x["substeps"])
    q, dq = x["q"], x["dq"]
    for _ in range(steps):
        q, dq = _runge_kutta(acceleration, q, dq, h / steps)
    return q, dq


def _runge_kutta(
    acceleration: Callable[[Array, Array], Array], q: Array, dq: Array, h: float
) -> tuple[Array, Array]:
    """(q, dq) a time h (s) later, by one step of the classical method."""
    k1, l1 = dq, acceleration(q, dq)
    k2 = dq + h / 2 * l1
    l2 = acceleration(q + h / 2 * k1, k2)
    k3 = dq + h / 2 * l2
    l3 = acceleration(q + h / 2 * k2, k3)
    k4 = dq + h * l3
    l4 = acceleration(q + h * k3, k4)
    return q + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), dq + h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)
