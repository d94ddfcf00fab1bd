"""Small components for tests of plan and engine: as little as a user would write."""

from __future__ import annotations

import numpy as np

from cosim.base.component import Parameter, Port


class Gain:
    """Sampled: y = gain * u."""

    kind = "sampled"
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    parameters = (Parameter("gain", (1.0,)),)

    def initialize(self, values):
        self.gain = float(values.get("gain", 1.0))

    def initial(self, u):
        return {"y": 0.0}

    def step(self, t, h, u):
        return {"y": self.gain * u["u"]}

    def get_state(self):
        return self.gain

    def set_state(self, state):
        self.gain = state


class Milliseconds(Gain):
    """Sampled: a gain whose input is in milliseconds."""

    inputs = (Port("u", (), "ms"),)


class Pair(Gain):
    """Sampled: a gain that is told the age of its input."""

    inputs = (Port("u", (), "s"), Port("age", (), "s"))


class Integrator:
    """Continuous: dx/dt = u, y = x, exact for held inputs."""

    kind = "continuous"
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    parameters = (Parameter("x", (0.0,)),)

    def initialize(self, values):
        self.x = float(values.get("x", 0.0))

    def initial(self, u):
        return {"y": self.x}

    def step(self, t, h, u):
        self.x += h * float(u["u"])
        return {"y": self.x}

    def get_state(self):
        return self.x

    def set_state(self, state):
        self.x = state


class Clock:
    """Sampled: y = (t, h) of each step; remembers them."""

    kind = "sampled"
    inputs = ()
    outputs = (Port("y", (2,), "s"),)
    parameters = ()

    def initialize(self, values):
        self.steps = []

    def initial(self, u):
        return {"y": [-1.0, -1.0]}

    def step(self, t, h, u):
        self.steps.append((t, h))
        return {"y": [t, h]}

    def get_state(self):
        return list(self.steps)

    def set_state(self, state):
        self.steps = list(state)


class Wide:
    """Sampled: y = u + 1, a (2, 3) signal in millimetres; or an exception, or nothing, or NaN."""

    kind = "sampled"
    inputs = (Port("u", (2, 3), "mm"),)
    outputs = (Port("y", (2, 3), "mm"),)
    parameters = (Parameter("fail_at", (-1.0,), (), "s"), Parameter("how", (0.0,), type="integer"))

    def initialize(self, values):
        self.fail_at = float(values.get("fail_at", -1.0))
        self.how = int(values.get("how", 0))

    def initial(self, u):
        return {"y": u["u"]}

    def step(self, t, h, u):
        y = u["u"] + 1.0
        if 0 <= self.fail_at <= t:
            if self.how == 0:
                raise ZeroDivisionError("one over nothing")
            if self.how == 1:
                return {}
            if self.how == 2:
                return {"y": np.zeros(5)}
            y[1, 2] = np.nan
        return {"y": y}

    def get_state(self):
        return None

    def set_state(self, state):
        del state


class Celsius:
    """Sampled: y = u in degrees Celsius."""

    kind = "sampled"
    inputs = (Port("u", unit="degC"),)
    outputs = (Port("y", unit="degC"),)
    parameters = ()

    def initialize(self, values):
        pass

    def initial(self, u):
        return {"y": float(u["u"])}

    def step(self, t, h, u):
        return {"y": float(u["u"])}


class Kelvin(Celsius):
    """Sampled: y = 300 K + t."""

    inputs = ()
    outputs = (Port("y", unit="K"),)

    def initial(self, u):
        return {"y": 300.0}

    def step(self, t, h, u):
        return {"y": 300.0 + t}
