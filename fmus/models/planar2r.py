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

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from cosim.errors import ScenarioError
from fmus.model import Model, Terminal, Variable
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

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
            "tau_h",
            "output",
            (2,),
            _TORQUE,
            description="Torque of the operator on the robot",
            elementwise=True,
            start_depends=("q", "dq", "k_p", "k_d", "q_h"),
        ),
        Variable(
            "tau_e",
            "output",
            (2,),
            _TORQUE,
            description="Torque of the robot on its environment",
            elementwise=True,
            start_depends=("q", "dq", "k_w", "b_w", "q_w"),
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


def inertia(theta: Array, q: Array) -> Array:
    """M(q), kg.m2, (2, 2); `theta` (3,) kg.m2, `q` (2,) rad."""
    c2 = np.cos(q[1])
    m12 = theta[2] + theta[1] * c2
    return np.array([[theta[0] + 2 * theta[1] * c2, m12], [m12, theta[2]]])


def coriolis(theta: Array, q: Array, dq: Array) -> Array:
    """C(q, dq), kg.m2/s, (2, 2), of Christoffel symbols, so that dM/dt - 2 C is skew-symmetric."""
    c = theta[1] * np.sin(q[1])
    return np.array([[-c * dq[1], -c * (dq[0] + dq[1])], [c * dq[0], 0.0]])


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
        """Outputs at the start; they do not depend on the inputs."""
        received(self.inputs, u)
        return self._measure(self._x["q"], self._x["dq"], 0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Integrate over [t, t + h) (s) with the inputs held; outputs at the end.

        Raises RunError where an input is not finite or the motion diverges; nothing changes then.
        """
        tau, tau_ext = received(self.inputs, u, t)
        substeps = int(self._x["substeps"])
        q, dq = self._x["q"], self._x["dq"]
        for _ in range(substeps):
            q, dq = self._runge_kutta(q, dq, tau + tau_ext, h / substeps)
        y = self._measure(q, dq, t)
        self._x["q"], self._x["dq"] = q, dq
        return y

    def _runge_kutta(self, q: Array, dq: Array, held: Array, h: float) -> tuple[Array, Array]:
        k1, l1 = dq, self._acceleration(q, dq, held)
        k2 = dq + h / 2 * l1
        l2 = self._acceleration(q + h / 2 * k1, k2, held)
        k3 = dq + h / 2 * l2
        l3 = self._acceleration(q + h / 2 * k2, k3, held)
        k4 = dq + h * l3
        l4 = self._acceleration(q + h * k3, k4, held)
        return q + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), dq + h / 6 * (l1 + 2 * l2 + 2 * l3 + l4)

    def _acceleration(self, q: Array, dq: Array, held: Array) -> Array:
        theta = self._x["theta"]
        torque = held + self._grip(q, dq) - self._wall(q, dq) - coriolis(theta, q, dq) @ dq
        return np.asarray(np.linalg.solve(inertia(theta, q), torque), dtype=np.float64)

    def _grip(self, q: Array, dq: Array) -> Array:
        return -self._x["k_d"] * dq - self._x["k_p"] * (q - self._x["q_h"])

    def _wall(self, q: Array, dq: Array) -> Array:
        depth = q - self._x["q_w"]
        push = np.maximum(0.0, self._x["k_w"] * depth + self._x["b_w"] * dq)
        return np.where(depth > 0, push, 0.0)

    def _measure(self, q: Array, dq: Array, t: float) -> dict[str, Array]:
        tau_h, tau_e = self._grip(q, dq), self._wall(q, dq)
        return given({"q": q, "dq": dq, "tau_h": tau_h, "tau_e": tau_e}, t)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
