"""Plants whose outputs depend on their inputs at once, and the solution of their loops."""

from __future__ import annotations

import numpy as np

from cosim.base.component import Parameter, Port
from tests.cosim.blocks import Integrator

HERE = "tests.cosim.algorithms.direct"
INPUTS = ("u0", "u1", "u2")


class Drifting:
    """dx/dt = v, y = x + the sum of d_i u_i; z = x. It counts its steps."""

    kind = "continuous"
    inputs = tuple(Port(name) for name in INPUTS)
    outputs = (Port("y"), Port("z"))
    parameters = (Parameter("x", (0.0,)), Parameter("v", (0.0,)), Parameter("d", (0.0,) * 3, (3,)))

    def initialize(self, values):
        self.x, self.v = (float(values.get(name, 0.0)) for name in "xv")
        self.d = np.broadcast_to(values.get("d", 0.0), 3)
        self.steps = 0

    def value(self, u):
        return float(self.d @ [float(u[name]) for name in INPUTS])

    def initial(self, u):
        return {"y": self.x + self.value(u), "z": self.x}

    def step(self, t, h, u):
        self.steps += 1
        self.x += self.v * h
        return self.initial(u)

    def get_state(self):
        return self.x

    def set_state(self, state):
        self.x = state


class Squaring(Drifting):
    """y = x + u_0²."""

    def value(self, u):
        return float(u["u0"]) ** 2


class Overflowing(Squaring):
    """The same, up to u_0 = 10."""

    def value(self, u):
        return super().value(u) if float(u["u0"]) < 10.0 else float("inf")


class Cubing(Drifting):
    """y = x + d_0 u_0³ + d_1 u_1."""

    def value(self, u):
        return float(self.d[0]) * float(u["u0"]) ** 3 + float(self.d[1]) * float(u["u1"])


class Crossing(Drifting):
    """Its output depends on u0 only; u1 moves it: dx/dt = u_1."""

    def value(self, u):
        return float(self.d[0]) * float(u["u0"])

    def step(self, t, h, u):
        self.v = float(u["u1"])
        return super().step(t, h, u)


class Relaxing(Integrator):
    """dx/dt = u - x, exactly for a held input; y = x + u."""

    def initial(self, u):
        return {"y": self.x + float(u["u"])}

    def step(self, t, h, u):
        end = float(u["u"])
        self.x = end + (self.x - end) * float(np.exp(-h))
        return {"y": self.x + end}


def plant(x=0.0, v=0.0, d=(0.0, 0.0, 0.0), model="Drifting", **inputs):
    """A component of a scenario."""
    return {"model": f"{HERE}:{model}", "inputs": inputs,
            "parameters": {"x": x, "v": v, "d": list(d)}}  # fmt: skip


def pair(first, second, model="Drifting"):
    """Two plants in a loop, y_a = x_a + first y_b and y_b = x_b + second y_a; x from 1 and 0.5."""
    return {
        "a": plant(1.0, 1.0, (first, 0.0, 0.0), model, u0="b.y"),
        "b": plant(0.5, -0.5, (second, 0.0, 0.0), u0="a.y"),
    }


def gains(components):
    """dy/dy of plants of this kind, (components, components): from the second to the first."""
    names = list(components)
    found = np.zeros((len(names), len(names)))
    for i, spec in enumerate(components.values()):
        for port, source in spec["inputs"].items():
            gain = 1.0
            if not isinstance(source, str):
                source, gain = source["from"], source["gain"]
            d = spec["parameters"]["d"][INPUTS.index(port)]
            found[i, names.index(source.split(".")[0])] += gain * d
    return found


def solution(components, t):
    """y of all plants of this kind at times t (n,): (n, components)."""
    given = [spec["parameters"] for spec in components.values()]
    x = np.array([values["x"] + t * values["v"] for values in given])
    return np.linalg.solve(np.eye(len(given)) - gains(components), x).T


class Mixing(Drifting):
    """The same of vectors, y = x + d M u: M mixes all scalars, and stretches some by 1."""

    SIZE = 4
    inputs = (Port("u", (SIZE,)),)
    outputs = (Port("y", (SIZE,)), Port("z"))
    parameters = tuple(Parameter(name, (0.0,)) for name in "xvd")

    @classmethod
    def matrix(cls):
        """M, symmetric, (SIZE, SIZE): its eigenvalues are from -1 to 1."""
        i = np.arange(cls.SIZE) + 0.5
        modes = np.sqrt(2.0 / cls.SIZE) * np.sin(np.pi * np.outer(i, i) / cls.SIZE)
        return modes @ np.diag(np.linspace(-1.0, 1.0, cls.SIZE)) @ modes.T

    def initialize(self, values):
        self.x, self.v, d = (float(values.get(name, 0.0)) for name in "xvd")
        self.d, self.steps = d * self.matrix(), 0

    def value(self, u):
        return self.d @ u["u"] + 0.1 * np.arange(self.SIZE)


class Wide(Mixing):
    """More scalars than passes are remembered."""

    SIZE = 25
    inputs = (Port("u", (SIZE,)),)
    outputs = (Port("y", (SIZE,)), Port("z"))
