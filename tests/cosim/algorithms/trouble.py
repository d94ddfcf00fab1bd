"""Integrators with direct feed-through, and some that fail while their steps are tried."""

from __future__ import annotations

from cosim.base.component import Port
from tests.cosim.algorithms.masses import Mass
from tests.cosim.blocks import Integrator


class Raises(Integrator):
    """Raises in any step that begins between 2 s and 2.5 s, tried or not."""

    def step(self, t, h, u):
        if 2.0 < t < 2.5:
            raise ZeroDivisionError("one over nothing")
        return super().step(t, h, u)


class NotANumber(Integrator):
    """Its output is no number in such a step."""

    def step(self, t, h, u):
        found = super().step(t, h, u)
        return {"y": float("nan")} if 2.0 < t < 2.5 else found


class OnlyShort(Integrator):
    """Its output is no number after a step longer than 0.1 s."""

    def step(self, t, h, u):
        found = super().step(t, h, u)
        return {"y": float("inf")} if h > 0.1 else found


class NoWayBack(Integrator):
    """Cannot restore what it has saved."""

    def set_state(self, state):
        raise RuntimeError("there is no way back")


class Passing(Integrator):
    """dx/dt = u, y = x + u / 2."""

    def initial(self, u):
        return {"y": self.x + 0.5 * float(u["u"])}

    def step(self, t, h, u):
        self.x += h * float(u["u"])
        return {"y": self.x + 0.5 * float(u["u"])}


class Warming(Integrator):
    """dx/dt = u, y = x, of a temperature in degC, as one in K."""

    inputs = (Port("u", unit="degC"),)
    outputs = (Port("y", unit="K"),)


class PassingHeat(Passing):
    """With direct feed-through."""

    inputs, outputs = Warming.inputs, Warming.outputs


class BreakingMass(Mass):
    """The first mass, which no longer exists after 2 s."""

    def step(self, t, h, u):
        if t > 2.0:
            raise ZeroDivisionError("the mass is gone")
        return super().step(t, h, u)
