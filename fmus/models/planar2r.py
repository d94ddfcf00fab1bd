"""Planar arm with two revolute joints, horizontal (no gravity), without friction.

Equation of motion (the paper's (1), with g = 0), three lumped parameters theta = (θ1, θ2, θ3)::

    M(q) ddq + C(q, dq) dq = tau + tau_ext + tau_h - tau_e

    M = [ θ1 + 2 θ2 c2   θ3 + θ2 c2 ]      C = [ -θ2 s2 dq2   -θ2 s2 (dq1 + dq2) ]
        [ θ3 + θ2 c2     θ3         ]          [  θ2 s2 dq1    0                 ]

    c2 = cos q2, s2 = sin q2;   θ1 = m1 lc1² + I1 + m2 (l1² + lc2²) + I2,  θ2 = m2 l1 lc2,
    θ3 = m2 lc2² + I2;   M - positive definite iff θ3 > 0 and θ1 θ3 - θ3² - θ2² > 0

Two parts of the surroundings may be solved inside the arm, at the rate of the integrator, so that
a stiff grip or contact is not limited by the communication step. Both are off by default::

    tau_h = -k_d dq - k_p (q - q_h)                      operator's grip, torque on the robot
    tau_e = max(0, k_w (q - q_w) + b_w dq)  if q > q_w   wall of each joint, torque of the robot
            0                               otherwise    on its environment

Integrated by the classical Runge-Kutta method of order 4 with `substeps` equal substeps in a
communication step. tau and tau_ext are held over the step; tau_h and tau_e are evaluated at every
stage, and as outputs at the end of the step.
"""

from __future__ import annotations

from cosim.component import Kind
from fmus.model import Model, Terminal, Variable

#: Lumped parameters theta, kg.m2. ``SL91``: Slotine and Li, Applied Nonlinear Control (1991),
#: two-link example of chapter 9 with δe = 0; ``IMI``: direct-drive arm; ``unit``: two rods of
#: 1 kg and 1 m; ``heavy``: rods of 4 kg and 3 kg, 1 m.
PRESETS: dict[str, dict[str, tuple[float, float, float]]] = {
    "SL91": {"theta": (3.34, 1.20, 0.97)},
    "IMI": {"theta": (3.473, 0.242, 0.196)},
    "unit": {"theta": (5 / 3, 1 / 2, 1 / 3)},
    "heavy": {"theta": (16 / 3, 3 / 2, 1.0)},
}

_KIND: Kind = "continuous"
_TORQUE, _RATE = "N.m", "rad/s"
_STIFFNESS, _DAMPING = "N.m/rad", "N.m.s/rad"


def _ports() -> tuple[Variable, ...]:
    return (
        Variable("tau", "input", (2,), _TORQUE, description="Control torque"),
        Variable("tau_ext", "input", (2,), _TORQUE, description="External torque fed in"),
        Variable("q", "output", (2,), "rad", settable=True, description="Joint position"),
        Variable("dq", "output", (2,), _RATE, settable=True, description="Joint velocity"),
        Variable(
            "tau_h", "output", (2,), _TORQUE, description="Torque of the operator on the robot"
        ),
        Variable(
            "tau_e", "output", (2,), _TORQUE, description="Torque of the robot on its environment"
        ),
    )


def _parameters() -> tuple[Variable, ...]:
    theta = PRESETS["SL91"]["theta"]
    return (
        Variable("theta", "parameter", (3,), "kg.m2", theta, "Lumped inertia parameters"),
        Variable("k_p", "parameter", (2,), _STIFFNESS, 0.0, "Stiffness of the grip", minimum=0.0),
        Variable("k_d", "parameter", (2,), _DAMPING, 0.0, "Damping of the grip", minimum=0.0),
        Variable("q_h", "parameter", (2,), "rad", 0.0, "Position the operator wants"),
        Variable("k_w", "parameter", (2,), _STIFFNESS, 0.0, "Stiffness of the wall", minimum=0.0),
        Variable("b_w", "parameter", (2,), _DAMPING, 0.0, "Damping of the wall", minimum=0.0),
        Variable("q_w", "parameter", (2,), "rad", 0.0, "Position of the wall"),
        Variable(
            "substeps",
            "parameter",
            start=1.0,
            description="Integrator steps in a communication step",
            type="integer",
            minimum=1.0,
        ),
    )


def model() -> Model:
    """Declare the arm: the defaults are the preset SL91, no grip, no wall."""
    return Model(
        identifier="planar2r",
        description="Planar arm with two revolute joints, operator's grip and wall inside",
        kind=_KIND,
        variables=_ports() + _parameters(),
        sources=("planar2r.c", "trig.c"),
        step=1e-3,
        terminals=(Terminal("joints", ("tau", "q", "dq"), "Torque in, position and velocity out"),),
        documentation=__doc__ or "",
    )
