"""Inputs and agents of the experiments that :mod:`fmus.models` does not provide, in Python.

A scenario names the function and gives its values as options::

    [components.hand]
    model = "fmus.paper.components:sine"
    options = { amplitude = [1.0, 0.0], rate = 20.0 }

Source: own construction.

Sampled: the value of t_k is held to the next step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import cos, exp, sin
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.component import Kind, Parameter, Port

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values

Array = NDArray[np.float64]


@final
class Waveform:
    """A known function of time as a component without inputs.

    `values`: the output at a time (s), of the shape of `port` and in its unit.
    """

    kind: Kind = "sampled"
    inputs: tuple[Port, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __init__(self, port: Port, values: Callable[[float], Any]) -> None:
        self.outputs: tuple[Port, ...] = (port,)
        self._name, self._values = port.name, values

    def initialize(self, values: Values) -> None:
        """Nothing can be set."""

    def initial(self, u: Values) -> Outputs:
        """The value at t = 0, in the unit of the port."""
        return {self._name: self._values(0.0)}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """The value at `t` (s), in the unit of the port; the step `h` (s) does not matter."""
        return {self._name: self._values(t)}

    def get_state(self) -> object:
        """Nothing: the value depends on time only."""
        return None

    def set_state(self, state: object) -> None:
        """Nothing to restore."""


def sine(amplitude: Sequence[float], rate: float) -> Waveform:
    """tau_h = amplitude sin(rate t): `amplitude` (2,), N.m, `rate` in rad/s."""
    a = np.array(amplitude, dtype=np.float64)
    return Waveform(_torque(), lambda t: a * sin(rate * t))


def swelling(amplitude: Sequence[float], rate: float, until: float) -> Waveform:
    """tau_h = amplitude exp(rate (t - until)), 0 from `until` (s) on: `rate` in 1/s, (2,), N.m."""
    a = np.array(amplitude, dtype=np.float64)
    return Waveform(_torque(), lambda t: a * exp(rate * (t - until)) if t < until else 0.0 * a)


def chirp(rate: float, fading: bool = False, unit: str = "N") -> Waveform:
    """Output u = dw/dt of w = sin(rate t²), or of w = sin(rate t²)/(t + 1) if `fading`.

    `rate` in rad/s²; `unit` of u. The first w is bounded and its u is not; the second w is
    square-integrable and its u is not.
    """

    def slope(t: float) -> float:
        wave, steep = sin(rate * t * t), 2.0 * rate * t * cos(rate * t * t)
        return steep / (t + 1.0) - wave / (t + 1.0) ** 2 if fading else steep

    return Waveform(Port("u", (), unit, "Chirp"), slope)


def fading(size: float, unit: str = "N") -> Waveform:
    """Output u = size/(t + 1), `size` in the `unit` of u."""
    return Waveform(Port("u", (), unit, "Fades"), lambda t: size / (t + 1.0))


def steady(size: float, unit: str = "N") -> Waveform:
    """Output u = size, in the `unit` of u."""
    return Waveform(Port("u", (), unit, "Steady"), lambda t: size)


def square(low: float, high: float, half: float) -> Waveform:
    """Friction b = low for `half` s, then high for `half` s, and so on, in N.s/m."""
    port = Port("b", (), "N.s/m", "Friction that alternates")
    return Waveform(port, lambda t: low if int((t + 1e-9) / half) % 2 == 0 else high)


def _torque() -> Port:
    return Port("tau_h", (2,), "N.m", "Torque on an arm")


@final
class LinearAgent:
    """A scalar agent of a linear network with delays, the subject of Lemmas 1 and 3 of the paper.

    dx/dt = F + u with F = -rate (x - x_in), x_in the neighbour's x as received; `rate` in 1/s,
    `start` is x at t = 0, m. Outputs as of t_k; exact for inputs that are held over the step.

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
