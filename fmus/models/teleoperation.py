"""Adaptive controller with dynamic feedback, for a teleoperator or a network of arms.

Equations (76)-(81) of the paper; with `lambda` = 1 and w_ij in `w` the same are (42)-(45) and,
for delayed xi_in, (61). For one arm, and its n neighbours j::

    xi         = dq + alpha q                                                  sent
    dz         = -alpha dq + lambda_M (dq - z) - lambda Σ_j w_j (xi - xi_in_j)  (80), (81)
    s          = dq - z                                                        (43)
    tau        = -K s + Y(q, dq, z, dz) theta_hat                              (76), (78)
    dtheta_hat = -Gamma Yᵀ(q, dq, z, dz) s                                     (77), (79)

    Y(q, dq, z, dz) theta = M(q) dz + C(q, dq) z,  c2 = cos q2, s2 = sin q2:

    Y = [ dz1   c2 (2 dz1 + dz2) - s2 (dq2 z1 + (dq1 + dq2) z2)   dz2       ]
        [ 0     c2 dz1 + s2 dq1 z1                                dz1 + dz2 ]

Sampled: the step at t_k reads q, dq, xi_in and w, gives xi, s, z, theta_hat and tau as of t_k, and
advances z and theta_hat by one step of the explicit Euler method to t_k + h. Each joint's torque is
limited to ±tau_max; while any joint is at its limit z and theta_hat stand still (anti-windup).

`lambda` carries the unit 1/s, `w` is a pure number: the paper's w_ij is their product.
K and Gamma are diagonal, one entry a joint and a parameter.
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

_KIND: Kind = "sampled"
_TORQUE, _RATE = "N.m", "rad/s"
_ALL = ("q", "dq", "xi_in", "w")


def _inputs(n: int) -> tuple[Variable, ...]:
    return (
        Variable("q", "input", (2,), "rad", description="Joint position"),
        Variable("dq", "input", (2,), _RATE, description="Joint velocity"),
        Variable("xi_in", "input", (n, 2), _RATE, description="Received xi, a row a neighbour"),
        Variable("w", "input", (n,), "1", 1.0, "Weight of each neighbour's edge, 0 = inactive"),
    )


def _outputs() -> tuple[Variable, ...]:
    return (
        Variable(
            "tau",
            "output",
            (2,),
            _TORQUE,
            description="Control torque",
            depends=_ALL,
            start_depends=("z", "theta_hat", "K", "alpha", "lambda", "lambda_M", "tau_max"),
        ),
        Variable(
            "xi",
            "output",
            (2,),
            _RATE,
            description="Signal sent: dq + alpha q",
            depends=("q", "dq"),
            elementwise=True,
            start_depends=("alpha",),
        ),
        Variable(
            "s",
            "output",
            (2,),
            _RATE,
            description="Sliding vector: dq - z",
            depends=("dq",),
            elementwise=True,
            start_depends=("z",),
        ),
        Variable(
            "z", "output", (2,), _RATE, description="State of the dynamic feedback", settable=True
        ),
        Variable(
            "theta_hat",
            "output",
            (3,),
            "kg.m2",
            description="Estimate of the lumped inertia parameters",
            settable=True,
        ),
        Variable("z_next", "local", (2,), _RATE, description="z of the next step"),
        Variable("theta_hat_next", "local", (3,), "kg.m2", description="theta_hat of the next"),
    )


def _parameters() -> tuple[Variable, ...]:
    adaptation = "kg.m2.s2/rad2"
    return (
        Variable("K", "parameter", (2,), "N.m.s/rad", 16.0, "Feedback gain of s", minimum=0.0),
        Variable("Gamma", "parameter", (3,), adaptation, 1.0, "Adaptation gain", minimum=0.0),
        Variable("alpha", "parameter", (), "1/s", 0.5, "Gain of q in xi", minimum=0.0),
        Variable("lambda", "parameter", (), "1/s", 2.0, "Coupling gain", minimum=0.0),
        Variable("lambda_M", "parameter", (), "1/s", 10.0, "Manipulability gain", minimum=0.0),
        Variable("tau_max", "parameter", (2,), _TORQUE, 1e9, "Limit of the torque", minimum=0.0),
    )


def model(neighbours: int = 1) -> Model:
    """Declare the controller for `neighbours` (>= 1) received signals; defaults: Sec. VII-C.

    Raises ScenarioError where `neighbours` is not a positive integer.
    """
    if neighbours < 1:
        raise ScenarioError(
            f"neighbours is {neighbours}, expected at least 1 (w = 0 switches one off)",
            "fmus.models.teleoperation",
        )
    suffix = "" if neighbours == 1 else f"_n{neighbours}"
    return Model(
        identifier=f"teleoperation{suffix}",
        description=f"Adaptive controller with dynamic feedback, {neighbours} neighbour(s)",
        kind=_KIND,
        variables=_inputs(neighbours) + _outputs() + _parameters(),
        sources=("teleoperation.c", "trig.c"),
        step=5e-3,
        terminals=(
            Terminal("joints", ("q", "dq", "tau"), "Position and velocity in, torque out"),
            Terminal("network", ("xi", "xi_in", "w"), "Signals exchanged with the neighbours"),
        ),
        documentation=__doc__ or "",
    )


def fmu(version: Version = "2.0", neighbours: int = 1) -> Path:
    """Path of the FMU, built at installation or now into the cache; `version` of FMI.

    Raises FmuError where it cannot be built.
    """
    from fmus.build import find

    return find(model(neighbours), version)


def kernel(neighbours: int = 1) -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
    from fmus.kernel import Kernel

    return Kernel(model(neighbours))


def regressor(q: Array, dq: Array, z: Array, dz: Array) -> Array:
    """Y(q, dq, z, dz), (2, 3), with Y theta = M(q) dz + C(q, dq) z for every theta (3,)."""
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    y12 = c2 * (2 * dz[0] + dz[1]) - s2 * (dq[1] * z[0] + (dq[0] + dq[1]) * z[1])
    return np.array([[dz[0], y12, dz[1]], [0.0, c2 * dz[0] + s2 * dq[0] * z[0], dz[0] + dz[1]]])


@final
class Teleoperation:
    """The controller in NumPy: the readable reference of the C kernel."""

    kind: Kind = "sampled"

    def __init__(self, neighbours: int = 1) -> None:
        self._model = model(neighbours)
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self.initialize({})

    def initialize(self, values: Values) -> None:
        """Go to the start. Raises ScenarioError."""
        self._x = start_values(self._model, values)  # parameters, and the state z, theta_hat
        self._x["z_next"], self._x["theta_hat_next"] = self._x["z"], self._x["theta_hat"]

    def initial(self, u: Values) -> Outputs:
        """Outputs for the start values of z and theta_hat; these do not advance."""
        outputs, *_ = self._law(0.0, received(self.inputs, u), self._x["z"], self._x["theta_hat"])
        return given(outputs)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; z and theta_hat advance to t + h.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        x, inputs = self._x, received(self.inputs, u, t)
        outputs, z_next, theta_hat_next = self._law(h, inputs, x["z_next"], x["theta_hat_next"])
        given(outputs, t)
        x["z"], x["theta_hat"] = outputs["z"], outputs["theta_hat"]
        x["z_next"], x["theta_hat_next"] = z_next, theta_hat_next
        return outputs

    def _law(
        self, h: float, inputs: list[Array], z: Array, theta_hat: Array
    ) -> tuple[dict[str, Array], Array, Array]:
        """Outputs for the state z (2,), theta_hat (3,), and the state a time h (s) later."""
        q, dq, xi_in, w = inputs  # (2,), (2,), (n, 2), (n,)
        x, alpha, tau_max = self._x, self._x["alpha"], self._x["tau_max"]
        xi = dq + alpha * q
        dz = -alpha * dq + x["lambda_M"] * (dq - z) - x["lambda"] * (w @ (xi - xi_in))
        s = dq - z
        Y = regressor(q, dq, z, dz)
        wanted = -x["K"] * s + Y @ theta_hat
        tau = np.clip(wanted, -tau_max, tau_max)
        outputs = {"tau": tau, "xi": xi, "s": s, "z": z, "theta_hat": theta_hat}
        if (tau != wanted).any():
            return outputs, z, theta_hat
        return outputs, z + h * dz, theta_hat - h * x["Gamma"] * (Y.T @ s)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
