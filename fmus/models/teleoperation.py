"""Adaptive controller with dynamic feedback: for one arm, a teleoperator or a network of arms.

One law serves the whole paper, for one arm and its n neighbours j::

    xi         = dq + alpha q                                                  sent, (47)
    dz         = -alpha dq + lambda_M (dq - z) - lambda Σ_j w_j (xi - xi_in_j)
    s          = dq - z
    tau        = -K s + Y(q, dq, z, dz) theta_hat
    dtheta_hat = -Gamma Yᵀ(q, dq, z, dz) s

    Y = [ dz1   c2 (2 dz1 + dz2) - s2 (dq2 z1 + (dq1 + dq2) z2)   dz2       ]   c2 = cos q2
        [ 0     c2 dz1 + s2 dq1 z1                                dz1 + dz2 ]   s2 = sin q2

    n = 0, model ``adaptive``       (29)-(32), Theorem 2
    lambda = 1, w_ij in w           (42)-(45), Theorem 3; with delayed xi_in (61), Theorem 4
    n = 1, w = 1                    (76)-(81), Theorem 5

Sampled: the step at t_k reads its inputs, gives xi, s, z, theta_hat and tau as of t_k, and advances
z and theta_hat by one step of the explicit Euler method to t_k + h. `lambda` carries the unit 1/s,
`w` is a pure number: the paper's w_ij is their product. K and Gamma are diagonal, one entry a joint
and a parameter. alpha = 0 is for one arm alone: its velocity is the output then (Sec. IV-C); with
neighbours alpha > 0 is needed, or velocities would agree and positions not.

Options, all of them off by default:

tau_max: each joint's torque is limited to ±tau_max; while any joint is at its limit z and theta_hat
stand still (anti-windup).

theta_min, theta_max: theta_hat is clipped to these bounds after each Euler step. Where the true
theta lies between them this takes nothing from dV/dt <= -sᵀ K s: Gamma is diagonal, so clipping an
entry only shrinks its term (theta_hat_i - theta_i)² / (2 Gamma_i) of V.

age, age_max, age_fade: an edge with w_j > 0 whose signal is older than age_max is stale. While
there is one theta_hat stands still, and its weight falls linearly, from w_j at age_max to 0 at
age_max + age_fade (at once with age_fade = 0); z goes on, so the arm stays manipulable.

lambda_c > 0 (Remark 3): K = lambda_c M_hat(q), the inertia as estimated; K itself is not used.
That is one regressor, in torque and adaptation::

    tau = Y* theta_hat,   dtheta_hat = -Gamma Y*ᵀ s,   Y* = Y(q, dq, z, dz - lambda_c s)

so that dV/dt = -lambda_c sᵀ M s + sᵀ tau_h. theta_hat = 0 gives no feedback at all: start from an
estimate, and keep it an inertia by theta_min.

Gravity (models built with `gravity`): theta_hat has two more entries, G theirs in Y, and
`gravity` says what becomes of g(q) = G(q) theta_g::

    G = [ cos q1   cos (q1 + q2) ]     0  none         nothing is said about gravity
        [ 0        cos (q1 + q2) ]     1  compensated  tau += G theta_g; theta_hat[3:] stands still
                                       2  adapted      Y = [Y G], theta_hat[3:] adapts

The default is 1, with what the platform knows in theta_g, because adapting gravity takes away what
the law is for: theta_hat integrates Gᵀ s, and any constant push ends up in the estimate,
G (theta_hat[3:] - theta_g) = -tau_h with s = 0. The arm stops although it is pushed, and the torque
that a teleoperator reflects decays. (The paper's bounds "<= ∞" stay true; its Sec. VII has g = 0.)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from cosim.errors import ScenarioError
from fmus.model import Model, Terminal
from fmus.models.adaptive_variables import variables
from fmus.models.dynamics import gravity_regressor, regressor
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.component import Outputs, Values
    from fmus.build import Version
    from fmus.kernel import Kernel

__all__ = ["ADAPTED", "COMPENSATED", "NONE", "Teleoperation", "fmu", "kernel", "model", "regressor"]

#: Values of the parameter `gravity`.
NONE, COMPENSATED, ADAPTED = 0, 1, 2

_KIND: Kind = "sampled"


def model(neighbours: int = 1, gravity: bool = False) -> Model:
    """Declare the controller for `neighbours` >= 0 received signals; defaults: Sec. VII-C.

    `gravity`: with two parameters of gravity in theta_hat. Without neighbours this is the model
    ``adaptive``. Raises ScenarioError for sizes that cannot be.
    """
    if neighbours < 0 or gravity not in (0, 1):
        raise ScenarioError(
            f"neighbours is {neighbours}, expected at least 0; gravity is {gravity}, expected 0, 1",
            "fmus.models.teleoperation",
        )
    stem = ("teleoperation" if neighbours else "adaptive") + ("_gravity" if gravity else "")
    joints = Terminal("joints", ("q", "dq", "tau"), "Position and velocity in, torque out")
    members = ("xi", "xi_in", "w", "age")
    network = Terminal("network", members, "Signals exchanged with the neighbours")
    whom = f"{neighbours} neighbour(s)" if neighbours else "one arm alone"
    return Model(
        identifier=f"{stem}_n{neighbours}" if neighbours > 1 else stem,
        description=f"Adaptive controller with dynamic feedback, {whom}"
        + (", gravity" if gravity else ""),
        kind=_KIND,
        variables=variables(neighbours, bool(gravity)),
        sources=(f"{stem}.c", "adaptive_law.h", "regressor.h", "limit.h", "trig.c"),
        step=5e-3,
        terminals=(joints, network) if neighbours else (joints,),
        documentation=__doc__ or "",
    )


def fmu(version: Version = "2.0", neighbours: int = 1, gravity: bool = False) -> Path:
    """Path of the FMU, built at installation or now into the cache; `version` of FMI.

    Raises FmuError where it cannot be built.
    """
    from fmus.build import find

    return find(model(neighbours, gravity), version)


def kernel(neighbours: int = 1, gravity: bool = False) -> Kernel:
    """The C kernel of the FMU as a component, without FMI in between: the same numbers."""
    from fmus.kernel import Kernel

    return Kernel(model(neighbours, gravity))


@final
class Teleoperation:
    """The controller in NumPy: the readable reference of the C kernel."""

    kind: Kind = "sampled"

    def __init__(self, neighbours: int = 1, gravity: bool = False) -> None:
        self._model = model(neighbours, gravity)
        self._neighbours, self._gravity = neighbours, bool(gravity)
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self.initialize({})

    def initialize(self, values: Values) -> None:
        """Go to the start. Raises ScenarioError, also where theta_hat is outside of its bounds."""
        x = start_values(self._model, values)  # parameters, and the state z, theta_hat
        place = self._model.identifier
        if (x["theta_hat"] < x["theta_min"]).any() or (x["theta_hat"] > x["theta_max"]).any():
            raise ScenarioError(
                f"theta_hat starts at {x['theta_hat'].tolist()}, expected within theta_min "
                f"{x['theta_min'].tolist()} ... theta_max {x['theta_max'].tolist()}",
                place,
            )
        if self._neighbours and x["alpha"] <= 0:
            raise ScenarioError("alpha is 0, expected more than 0 with neighbours", place)
        self._x = x
        self._x["z_next"], self._x["theta_hat_next"] = x["z"], x["theta_hat"]

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
        """Outputs for the state z (2,), theta_hat (p,), and the state a time h (s) later."""
        q, dq, *network = inputs  # (2,), (2,)
        x, alpha, lambda_c = self._x, self._x["alpha"], self._x["lambda_c"]
        xi = dq + alpha * q
        coupling, stale = self._coupling(xi, network)
        dz = -alpha * dq + x["lambda_M"] * (dq - z) - coupling
        s = dq - z
        K = x["K"] if lambda_c == 0 else 0.0
        Y = self._regressor(q, dq, z, dz - lambda_c * s)  # (2, p)
        wanted = -K * s + Y @ theta_hat + self._compensation(q)
        tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
        outputs = {"tau": tau, "xi": xi, "s": s, "z": z, "theta_hat": theta_hat}
        if (tau != wanted).any():
            return outputs, z, theta_hat
        if not stale:
            adapted = theta_hat - h * x["Gamma"] * (Y.T @ s)
            theta_hat = np.clip(adapted, x["theta_min"], x["theta_max"])
        return outputs, z + h * dz, theta_hat

    def _coupling(self, xi: Array, network: list[Array]) -> tuple[Array, bool]:
        """(lambda Σ_j w_j (xi - xi_in_j), stale edges faded, whether any is stale)."""
        if not network:
            return np.zeros(2), False
        xi_in, w, age = network  # (n, 2), (n,), (n,)
        late, fade = age - self._x["age_max"], self._x["age_fade"]  # s
        stale = (w > 0) & (age > self._x["age_max"])
        left = np.where(late < fade, 1 - late / (fade or 1.0), 0.0)  # of the weight, (n,)
        return self._x["lambda"] * (np.where(stale, left * w, w) @ (xi - xi_in)), bool(stale.any())

    def _regressor(self, q: Array, dq: Array, z: Array, dz: Array) -> Array:
        """Y of what adapts, (2, p)."""
        Y = regressor(q, dq, z, dz)
        if not self._gravity:
            return Y
        adapted = self._x["gravity"] == ADAPTED
        return np.hstack([Y, gravity_regressor(q) if adapted else np.zeros((2, 2))])

    def _compensation(self, q: Array) -> Array:
        """Known gravity, N.m, (2,)."""
        if self._gravity and self._x["gravity"] == COMPENSATED:
            return np.asarray(gravity_regressor(q) @ self._x["theta_g"], dtype=np.float64)
        return np.zeros(2)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
