"""Python components with state."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from cosim.base.component import Outputs, Parameter, Port, Values


class Noise:
    """Random numbers of a generator that is part of the state."""

    kind = "sampled"
    inputs: tuple[Port, ...] = ()
    outputs = (Port("y", (2,)),)
    parameters: tuple[Parameter, ...] = ()

    def initialize(self, values: Values) -> None:
        self.generator = np.random.default_rng(5)

    def initial(self, u: Values) -> Outputs:
        return {"y": np.zeros(2)}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        return {"y": self.generator.normal(size=2)}

    def get_state(self) -> Any:
        return self.generator

    def set_state(self, state: Any) -> None:
        self.generator = state


class Mean:
    """The mean of the last inputs."""

    kind = "sampled"
    inputs = (Port("u", (2,)),)
    outputs = (Port("y", (2,)),)
    parameters: tuple[Parameter, ...] = ()

    def initialize(self, values: Values) -> None:
        self.last: deque[Any] = deque(maxlen=10)

    def initial(self, u: Values) -> Outputs:
        return {"y": np.zeros(2)}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        self.last.append(u["u"].copy())
        return {"y": sum(self.last) / len(self.last)}

    def get_state(self) -> Any:
        return {"last": self.last}

    def set_state(self, state: Any) -> None:
        self.last = state["last"]


class Forgetful(Mean):
    """Its state cannot be restored: it is a function."""

    def get_state(self) -> Any:
        return {"last": print}


class Silent:
    """A component without a state of its own, which does not say so."""

    kind = "sampled"
    inputs: tuple[Port, ...] = ()
    outputs = (Port("y"),)
    parameters: tuple[Parameter, ...] = ()

    def initialize(self, values: Values) -> None:
        pass

    def initial(self, u: Values) -> Outputs:
        return {"y": 0.0}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        return {"y": t}


class Steps:
    """An output that increases now and then, as one that triggers a clock."""

    kind = "sampled"
    inputs: tuple[Port, ...] = ()
    outputs = (Port("y"),)
    parameters: tuple[Parameter, ...] = ()

    def initialize(self, values: Values) -> None:
        self.k = 0

    def initial(self, u: Values) -> Outputs:
        return {"y": 0.0}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        self.k += 1
        return {"y": float(self.k // 37)}

    def get_state(self) -> Any:
        return self.k

    def set_state(self, state: Any) -> None:
        self.k = state
