"""What adaptive laws with static feedback share, in NumPy: the reference of ``static_feedback.h``.

The reference velocity z follows from what is measured and received::

    tau        = Y(q, dq, z, dz) theta_hat + feedback
    dtheta_hat = -Gamma Y' s,   s = dq - z

with the regressor Y of ``dynamics``. Outputs are as of t_k; theta_hat advances by the explicit
Euler method, and stands still while a torque is at its limit (anti-windup).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from cosim.component import Kind, Parameter, Port
from fmus.model import Model
from fmus.models.dynamics import regressor
from fmus.models.start import Array, copied, given, received, start_values

if TYPE_CHECKING:
    from cosim.component import Outputs, Values


class Law(NamedTuple):
    """What a law says at an instant, each (2,): `s` rad/s, `z` rad/s, `dz` rad/s², N.m."""

    s: Array
    z: Array
    dz: Array
    feedback: Array


@final
class StaticFeedback:
    """A controller of `model` by `law` (of its parameters and inputs); s is the output `name`."""

    kind: Kind = "sampled"

    def __init__(
        self,
        model: Callable[[], Model],
        name: str,
        law: Callable[[Mapping[str, Array], list[Array]], Law],
    ) -> None:
        self._model, self._name, self._law = model(), name, law
        self.inputs: tuple[Port, ...] = self._model.inputs()
        self.outputs: tuple[Port, ...] = self._model.outputs()
        self.parameters: tuple[Parameter, ...] = self._model.parameters()
        self.initialize({})

    def initialize(self, values: Values) -> None:
        """Go to the start. Raises ScenarioError."""
        self._x = start_values(self._model, values)  # parameters, and the state theta_hat
        self._x["theta_hat_next"] = self._x["theta_hat"]

    def initial(self, u: Values) -> Outputs:
        """Outputs for the start value of theta_hat; it does not advance."""
        outputs, _ = self._outputs(0.0, received(self.inputs, u), self._x["theta_hat"])
        return given(outputs)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; theta_hat advances to t + h.

        Raises RunError where an input is not finite or the law diverges; nothing changes then.
        """
        x, inputs = self._x, received(self.inputs, u, t)
        outputs, theta_hat_next = self._outputs(h, inputs, x["theta_hat_next"])
        given(outputs, t)
        x["theta_hat"], x["theta_hat_next"] = outputs["theta_hat"], theta_hat_next
        return outputs

    def _outputs(
        self, h: float, inputs: list[Array], theta_hat: Array
    ) -> tuple[dict[str, Array], Array]:
        """Outputs for the estimate theta_hat (3,), and the estimate a time h (s) later."""
        x, (q, dq, *_) = self._x, inputs
        law = self._law(x, inputs)
        Y = regressor(q, dq, law.z, law.dz)
        wanted = Y @ theta_hat + law.feedback
        tau = np.clip(wanted, -x["tau_max"], x["tau_max"])
        outputs = {"tau": tau, self._name: law.s, "theta_hat": theta_hat}
        if (tau != wanted).any():
            return outputs, theta_hat
        return outputs, theta_hat - h * x["Gamma"] * (Y.T @ law.s)

    def get_state(self) -> object:
        """Parameters and state, copied."""
        return copied(self._x)

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = copied(state)
