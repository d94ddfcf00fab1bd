"""Python components for tests of the command."""

from __future__ import annotations

import ctypes
import os
import signal

import numpy as np

from cosim.base.component import Kind, Outputs, Parameter, Port, Values


class Half:
    """Sampled: y = u / 2; NaN in the first entry from the time `fails` on, s."""

    kind: Kind = "sampled"
    inputs = (Port("u", (2,), "N.m"),)
    outputs = (Port("y", (2,), "N.m"),)
    parameters = (Parameter("fails", (float("inf"),), (), "s"),)

    def initialize(self, values: Values) -> None:
        self.fails = float(values.get("fails", np.array(np.inf)))

    def initial(self, u: Values) -> Outputs:
        return self.step(-1.0, 0.0, u)  # before the first step

    def step(self, t: float, h: float, u: Values) -> Outputs:
        y = u["u"] / 2
        if t >= self.fails:
            y[0] = np.nan
        return {"y": y}


class Ends:
    """Sampled: ends its own process at t = 1.5 s: 0 exit(0), 1 abort(), 2 a crash, 3 SIGKILL."""

    kind: Kind = "sampled"
    inputs = (Port("u"),)
    outputs = (Port("y"),)
    parameters = (Parameter("how", (0.0,)),)

    def initialize(self, values: Values) -> None:
        self.how = int(values["how"])

    def initial(self, u: Values) -> Outputs:
        return {"y": 1.0}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        if t >= 1.5:
            system = ctypes.CDLL(None)
            match self.how:
                case 0:
                    system.exit(0)
                case 1:
                    system.abort()
                case 2:
                    system.memset(None, 0, 1)
                case _:
                    os.kill(os.getpid(), signal.SIGKILL)
        return {"y": 1.0}


class Gone(Ends):
    """Ends its process with exit(0) when it is made."""

    def __init__(self) -> None:
        ctypes.CDLL(None).exit(0)
