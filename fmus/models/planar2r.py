"""Planar arm with two revolute joints, without friction; horizontal, or with gravity.

The equation of motion has three lumped parameters theta = (θ1, θ2, θ3) and two of gravity,
theta_g = (γ1, γ2). theta_g is zero by default, which means a horizontal plane::

    M(q) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e

    M = [ θ1 + 2 θ2 c2   θ3 + θ2 c2 ]      C = [ -θ2 s2 dq2   -θ2 s2 (dq1 + dq2) ]
        [ θ3 + θ2 c2     θ3         ]          [  θ2 s2 dq1    0                 ]

    g = [ γ1 cos q1 + γ2 cos (q1 + q2) ]
        [ γ2 cos (q1 + q2)             ]

    c2 = cos q2, s2 = sin q2;   θ1 = m1 lc1² + I1 + m2 (l1² + lc2²) + I2,  θ2 = m2 l1 lc2,
    θ3 = m2 lc2² + I2;   M - positive definite iff θ3 > 0 and θ1 θ3 - θ3² - θ2² > 0;
    γ1 = (m1 lc1 + m2 l1) 9.81 m/s²,  γ2 = m2 lc2 9.81 m/s²;   q = 0 is level, q1 = π/2 upright

The arm can include two parts of its environment, evaluated at the rate of the integrator, so that
the communication step does not limit the stiffness of a grip or contact. Both are off by default.
The first is the operator's torque on the robot, for each joint. The input `q_h` is the position of
the hand, and the input `grip` releases (0) or grasps (1) the arm::

    tau_h = grip (-k_d dq - k_p (q - q_h))

The second is the robot's torque on its environment, for each joint, at the depth x = q - q_w beyond
the wall. The parameter `contact` selects the law; the torque is 0 for x <= 0 and never negative::

    0   tau_e = max(0, k_w x + b_w dq)              spring and damper
    1   tau_e = max(0, x (k_w + b_w dq))            Hunt and Crossley, exponent 1
    2   tau_e = max(0, x^1.5 (k_w + b_w dq))        Hunt and Crossley, exponent 1.5

The damping of Hunt and Crossley grows with the depth, so that a contact begins and ends without a
jump. In their laws k_w and b_w are in N.m/rad^n and N.m.s/rad^(n+1), n being the exponent.

Source: the paper, eqs (1), (74), (75); K. H. Hunt, F. R. E. Crossley, "Coefficient of restitution
interpreted as damping in vibroimpact", J. Applied Mechanics 42(2), 1975.

The classical Runge-Kutta method of order 4 integrates the equation with `substeps` equal substeps
in a communication step. The inputs are held over the step; tau_h and tau_e are evaluated at every
stage, and as outputs at the end of the step.
"""

from __future__ import annotations

from cosim.base.component import Drawing
from cosim.base.errors import ScenarioError
from fmus.arms import environment
from fmus.arms.dynamics import coriolis, gravity, inertia
from fmus.arms.environment import grip_torque, wall_torque
from fmus.arms.joints import PLANAR, TORQUE
from fmus.build.reference import Values, derive
from fmus.model import Model, Variable
from fmus.model.numeric import Array, np

#: Lumped parameters theta, kg.m2, and theta_g, N.m. ``SL91``: Slotine and Li, Applied Nonlinear
#: Control (1991), two-link example of chapter 9 with δe = 0; ``IMI``: direct-drive arm; ``unit``:
#: two rods of 1 kg and 1 m; ``heavy``: rods of 4 kg and 3 kg, 1 m. ``SL91-upright`` and
#: ``unit-upright`` move in a vertical plane, the others in a horizontal one.
PRESETS: dict[str, dict[str, tuple[float, ...]]] = {
    "SL91": {"theta": (3.34, 1.20, 0.97)},
    "SL91-upright": {"theta": (3.34, 1.20, 0.97), "theta_g": (24.525, 11.772)},
    "IMI": {"theta": (3.473, 0.242, 0.196)},
    "unit": {"theta": (5 / 3, 1 / 2, 1 / 3)},
    "unit-upright": {"theta": (5 / 3, 1 / 2, 1 / 3), "theta_g": (14.715, 4.905)},
    "heavy": {"theta": (16 / 3, 3 / 2, 1.0)},
}


def _parameters() -> tuple[Variable, ...]:
    theta = PRESETS["SL91"]["theta"]
    return (
        Variable("theta", "parameter", (3,), "kg.m2", theta, "Lumped inertia parameters"),
        Variable("theta_g", "parameter", (2,), TORQUE, 0.0, "Gravity parameters, 0 = horizontal"),
    )


def model() -> Model:
    """Declare the arm: the defaults are the preset SL91, horizontal, no grip, no wall."""
    text = "Planar arm with two revolute joints"
    sources = ("planar2r.c",)
    return environment.plant("planar2r", text, PLANAR, _parameters(), sources, __doc__, lanes=True)


def law(
    x: Values, t: float, h: float, tau: Array, tau_ext: Array, q_h: Array, grip: Array
) -> Values:
    """The motion over [t, t + h), s, with the inputs held; tau_h and tau_e (2,) N.m at its end.

    `tau`, `tau_ext` (2,) N.m; `q_h` (2,) rad; `grip` scalar, 0 to 1.
    """

    def acceleration(q: Array, dq: Array) -> Array:
        return _acceleration(x, q, dq, tau + tau_ext + grip_torque(x, q, dq, q_h, grip))

    q, dq = environment.integrate(x, acceleration, h)
    return environment.outputs_at(x, q, dq, q_h, grip)


def start(x: Values, tau: Array, tau_ext: Array, q_h: Array, grip: Array) -> Values:
    """Outputs at the start; the inputs have the shapes and units of :func:`law`.

    Raises ScenarioError if M is not positive definite.
    """
    theta1, theta2, theta3 = x["theta"]
    if theta3 <= 0 or theta1 * theta3 - theta3**2 - theta2**2 <= 0:
        raise ScenarioError(
            f"inertia is not positive definite for {x['theta'].tolist()}; expected "
            "theta[2] > 0 and theta[0] theta[2] > theta[1]^2 + theta[2]^2",
            "planar2r.theta",
        )
    return environment.outputs_at(x, x["q"], x["dq"], q_h, grip)


def _acceleration(x: Values, q: Array, dq: Array, pushed: Array) -> Array:
    """ddq, rad/s2, where `pushed` is tau + tau_ext + tau_h."""
    theta = x["theta"]
    torque = pushed - wall_torque(x, q, dq) - coriolis(theta, q, dq) @ dq
    if x["theta_g"].any():
        torque = torque - gravity(x["theta_g"], q)
    return np.asarray(np.linalg.solve(inertia(theta, q), torque), dtype=np.float64)


fmu, kernel, Planar2R = derive(model, law, start)


def drawing(options: object, folder: object) -> Drawing:
    """The arm in a report: its parameters are lumped, so each link is drawn 1 m long."""
    level = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    link = (1.0, 0.0, 0.0)
    return Drawing(
        (False, False), (level, level), ((0.0, 0.0, 0.0), link), link, torque="tau_h", planar=True
    )
