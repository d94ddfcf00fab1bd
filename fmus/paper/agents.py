"""One scalar agent of a linear network with delays, the subject of Lemmas 1 and 3.

::

    dx/dt = F + u,   F = -rate (x - x_in)

with x_in the neighbour's x at the output of the link. Sampled: outputs as of t_k; exact for inputs
that are held over the step.

Source: the paper, Lemmas 1 and 3.
"""

from __future__ import annotations

from math import exp
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.component import Kind, Parameter, Port

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values


@final
class LinearAgent:
    """The agent above: `rate` in 1/s, `start` is x at t = 0, m.

    Outputs x (m), its derivative dx and the part F of it, m/s.
    """

    kind: Kind = "sampled"
    inputs: tuple[Port, ...] = (
        Port("x_in", (), "m", "x of the neighbour, as received"),
        Port("u", (), "m/s", "External input", optional=True),
    )
    outputs: tuple[Port, ...] = (
        Port("x", (), "m", "State"),
        Port("dx", (), "m/s", "Derivative of x"),
        Port("F", (), "m/s", "What the network makes of x"),
    )
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, rate: float = 1.0, start: float = 0.0) -> None:
        self._rate, self._start, self._x = rate, start, start

    def initialize(self, values: Values) -> None:
        """Go to the start; nothing can be set."""
        self._x = self._start

    def initial(self, u: Values) -> Outputs:
        """Outputs at t = 0, scalars."""
        return self._outputs(u)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs at `t` (s), scalars; x advances by `h` (s)."""
        found = self._outputs(u)
        decay = exp(-self._rate * h)
        far, input_ = float(np.asarray(u["x_in"])), float(np.asarray(u["u"]))
        self._x = far + (self._x - far) * decay + input_ * (1.0 - decay) / self._rate
        return found

    def _outputs(self, u: Values) -> Outputs:
        F = -self._rate * (self._x - float(np.asarray(u["x_in"])))
        return {"x": self._x, "dx": F + float(np.asarray(u["u"])), "F": F}

    def get_state(self) -> object:
        """The state x, m."""
        return self._x

    def set_state(self, state: object) -> None:
        """Continue from what :meth:`get_state` gave."""
        self._x = float(state)  # type: ignore[arg-type]
