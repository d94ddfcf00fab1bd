"""Planar arm with two revolute joints, without friction; horizontal, or with gravity.

Equation of motion (the paper's (1)), three lumped parameters theta = (θ1, θ2, θ3) and two of
gravity theta_g = (γ1, γ2), by default zero: the plane is horizontal::

    M(q) ddq + C(q, dq) dq + g(q) = tau + tau_ext + tau_h - tau_e

    M = [ θ1 + 2 θ2 c2   θ3 + θ2 c2 ]      C = [ -θ2 s2 dq2   -θ2 s2 (dq1 + dq2) ]
        [ θ3 + θ2 c2     θ3         ]          [  θ2 s2 dq1    0                 ]

    g = [ γ1 cos q1 + γ2 cos (q1 + q2) ]
        [ γ2 cos (q1 + q2)             ]

    c2 = cos q2, s2 = sin q2;   θ1 = m1 lc1² + I1 + m2 (l1² + lc2²) + I2,  θ2 = m2 l1 lc2,
    θ3 = m2 lc2² + I2;   M - positive definite iff θ3 > 0 and θ1 θ3 - θ3² - θ2² > 0;
    γ1 = (m1 lc1 + m2 l1) 9.81 m/s²,  γ2 = m2 lc2 9.81 m/s²;   q = 0 lies level, q1 = π/2 upright

Two parts of the surroundings may be solved inside the arm, at the rate of the integrator, so that
a stiff grip or contact is not limited by the communication step. Both are off by default. The
operator's torque on the robot, of each joint; the inputs `q_h` and `grip` move the hand and let go
(0) or grasp (1)::

    tau_h = grip (-k_d dq - k_p (q - q_h))

The robot's torque on its environment, of each joint, at the depth x = q - q_w beyond the wall, by
`contact`; 0 for x <= 0, and no wall ever pulls::

    0   tau_e = max(0, k_w x + b_w dq)              spring and damper
    1   tau_e = max(0, x (k_w + b_w dq))            Hunt and Crossley, exponent 1
    2   tau_e = max(0, x^1.5 (k_w + b_w dq))        Hunt and Crossley, exponent 1.5

The damping of Hunt and Crossley grows with the depth, so that a contact begins and ends without a
jump. k_w and b_w are in N.m/rad^n and N.m.s/rad^(n+1) there.

Integrated by the classical Runge-Kutta method of order 4 with `substeps` equal substeps in a
communication step. The inputs are held over the step; tau_h and tau_e are evaluated at every
stage, and as outputs at the end of the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from cosim.errors import ScenarioError
from fmus.model import Model, Terminal, Variable
from fmus.models.dynamics import coriolis, gravity, inertia
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

__all__ = ["PRESETS", "Planar2R", "coriolis", "fmu", "gravity", "inertia", "kernel", "model"]

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

_KIND: Kind = "continuous"
_TORQUE, _RATE = "N.m", "rad/s"
_STIFFNESS, _DAMPING = "N.m/rad", "N.m.s/rad"


def _ports() -> tuple[Variable, ...]:
    return (
        Variable("tau", "input", (2,), _TORQUE, description="Control torque"),
        Variable(
            *("tau_ext", "input", (2,), _TORQUE, 0.0, "External torque fed in"), optional=True
        ),
        Variable(*("q_h", "input", (2,), "rad", 0.0, "Position the operator wants"), optional=True),
        Variable(
            *("grip", "input", (), "1", 1.0, "Scale of the grip: 0 released, 1 held"), optional=True
        ),
        Variable("q", "output", (2,), "rad", settable=True, description="Joint position"),
        Variable("dq", "output", (2,), _RATE, settable=True, description="Joint velocity"),
        Variable(
            "tau_h",
            "output",
            (2,),
            _TORQUE,
            description="Torque of the operator on the robot",
            depends=("q_h", "grip"),
            elementwise=True,
            start_depends=("q", "dq", "k_p", "k_d"),
        ),
        Variable(
            "tau_e",
            "output",
            (2,),
            _TORQUE,
            description="Torque of the robot on its environment",
            elementwise=True,
            start_depends=("q", "dq", "k_w", "b_w", "q_w", "contact"),
        ),
    )


def _parameters() -> tuple[Variable, ...]:
    theta = PRESETS["SL91"]["theta"]
    return (
        Variable("theta", "parameter", (3,), "kg.m2", theta, "Lumped inertia parameters"),
        Variable("theta_g", "parameter", (2,), _TORQUE, 0.0, "Gravity parameters, 0 = horizontal"),
        Variable("k_p", "parameter", (2,), _STIFFNESS, 0.0, "Stiffness of the grip", minimum=0.0),
        Variable("k_d", "parameter", (2,), _DAMPING, 0.0, "Damping of the grip", minimum=0.0),
        Variable("k_w", "parameter", (2,), _STIFFNESS, 0.0, "Stiffness of the wall", minimum=0.0),
        Variable("b_w", "parameter", (2,), _DAMPING, 0.0, "Damping of the wall", minimum=0.0),
        Variable("q_w", "parameter", (2,), "rad", 0.0, "Position of the wall"),
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


def model() -> Model:
    """Declare the arm: the defaults are the preset SL91, horizontal, no grip, no wall."""
    return Model(
        identifier="planar2r",
        description="Planar arm with two revolute joints, operator's grip and wall inside",
        kind=_KIND,
        variables=_ports() + _parameters(),
        sources=("planar2r.c", "contact.c", "contact.h", "trig.c"),
        step=1e-3,
        terminals=(
            Terminal("joints", ("tau", "q", "dq"), "Torque in, position and velocity out"),
            Terminal("hand", ("q_h", "grip", "tau_h"), "The operator's hand"),
        ),
        documentation=__doc__ or "",
    )


def fmu(version: Version = "2.0") -> Path:
    """Path of the FMU, built at installation or now into the cache; `version` of FMI.

    Raises FmuError where it cannot be built.
    """
    from fmus.build import find

    return find(model(), version)


def kernel() -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
    from fmus.kernel import Kernel

    return Kernel(model())


@final
class Planar2R:
    """The arm in NumPy: the readable reference of the C kernel."""

    kind: Kind = "continuous"

    def __init__(self) -> None:
        self._model = model()
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self._x = start_values(self._model, {})  # parameters, and the state q, dq

    def initialize(self, values: Values) -> None:
        """Go to the start. Raises ScenarioError, also where M would not be positive definite."""
        x = start_values(self._model, values)
        theta1, theta2, theta3 = x["theta"]
        if theta3 <= 0 or theta1 * theta3 - theta3**2 - theta2**2 <= 0:
            raise ScenarioError(
                f"inertia is not positive definite for {x['theta'].tolist()}; expected "
                "theta[2] > 0 and theta[0] theta[2] > theta[1]^2 + theta[2]^2",
                "planar2r.theta",
            )
        self._x = x

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start; of the inputs, only q_h and grip matter."""
        _, _, q_h, grip = received(self.inputs, u)
        return self._measure(self._x["q"], self._x["dq"], q_h, grip, 0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Integrate over [t, t + h) (s) with the inputs held; outputs at the end.

        Raises RunError where an input is not finite or the motion diverges; nothing changes then.
        """
        tau, tau_ext, q_h, grip = received(self.inputs, u, t)
        substeps = int(self._x["substeps"])
        q, dq = self._x["q"], self._x["dq"]

        def acceleration(q: Array, dq: Array) -> Array:
            return self._acceleration(q, dq, tau + tau_ext + self._grip(q, dq, q_h, grip))

        for _ in range(substeps):
            q, dq = _runge_kutta(acceleration, q, dq, h / substeps)
        y = self._measure(q, dq, q_h, grip, t)
        self._x["q"], self._x["dq"] = q, dq
        return y

    def _acceleration(self, q: Array, dq: Array, pushed: Array) -> Array:
        """ddq, rad/s2, where `pushed` is tau + tau_ext + tau_h."""
        theta = self._x["theta"]
        torque = pushed - self._wall(q, dq) - coriolis(theta, q, dq) @ dq
        if self._x["theta_g"].any():
            torque = torque - gravity(self._x["theta_g"], q)
        return np.asarray(np.linalg.solve(inertia(theta, q), torque), dtype=np.float64)

    def _grip(self, q: Array, dq: Array, q_h: Array, grip: Array) -> Array:
        """tau_h, N.m."""
        return grip * (-self._x["k_d"] * dq - self._x["k_p"] * (q - q_h))

    def _wall(self, q: Array, dq: Array) -> Array:
        """tau_e, N.m."""
        k_w, b_w, contact = self._x["k_w"], self._x["b_w"], int(self._x["contact"])
        x = np.maximum(0.0, q - self._x["q_w"])
        if contact == 0:
            torque = k_w * x + b_w * dq
        else:
            torque = (x if contact == 1 else x * np.sqrt(x)) * (k_w + b_w * dq)
        return np.where(x > 0, np.maximum(0.0, torque), 0.0)

    def _measure(self, q: Array, dq: Array, q_h: Array, grip: Array, t: float) -> dict[str, Array]:
        tau_h, tau_e = self._grip(q, dq, q_h, grip), self._wall(q, dq)
        return given({"q": q, "dq": dq, "tau_h": tau_h, "tau_e": tau_e}, t)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)


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
