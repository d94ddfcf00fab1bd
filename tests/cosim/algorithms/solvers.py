"""Continuous components with a solver of a known order, or with a state that cannot be saved."""

from __future__ import annotations

from tests.cosim.blocks import Integrator


class Decay(Integrator):
    """dx/dt = u - x, y = x, by `STAGES` stages of a Runge-Kutta method of that order."""

    STAGES = 1

    def step(self, t, h, u):
        def rate(x):
            return float(u["u"]) - x

        x = self.x
        a = rate(x)
        b = rate(x + h / 2 * a)
        if self.STAGES == 1:
            self.x = x + h * a
        elif self.STAGES == 2:
            self.x = x + h * b
        else:
            c = rate(x + h / 2 * b)
            d = rate(x + h * c)
            self.x = x + h / 6 * (a + 2 * b + 2 * c + d)
        return {"y": self.x}


class Midpoint(Decay):
    """Order 2."""

    STAGES = 2


class Classical(Decay):
    """Order 4."""

    STAGES = 4


class Forgetful(Integrator):
    """An integrator with a state it does not save."""

    def set_state(self, state):
        del state


class Stateless:
    """An integrator that cannot save its state at all."""

    kind, inputs, outputs = Integrator.kind, Integrator.inputs, Integrator.outputs
    parameters = ()

    def initialize(self, values):
        self.x = 0.0

    def initial(self, u):
        return {"y": self.x}

    def step(self, t, h, u):
        self.x += h * float(u["u"])
        return {"y": self.x}
