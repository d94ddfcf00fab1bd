"""Python components for tests of the command."""

from __future__ import annotations

import numpy as np

from cosim.component import Kind, Outputs, Parameter, Port, Values


class Half:
    """Sampled: y = u / 2; NaN in the first entry from the time `fails` on, s."""

    kind: Kind = "sampled"
    inputs = (Port("u", (2,), "N.m"),)
    outputs = (Port("y", (2,), "N.m"),)
    parameters = (Parameter("fails", (float("inf"),), (), "s"),)

    def initialize(self, values: Values) -> None:
        self.fails = float(values.get("fails", np.array(np.inf)))

    def initial(self, u: Values) -> Outputs:
        return {"y": u["u"] / 2}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        y = u["u"] / 2
        if t >= self.fails:
            y[0] = np.nan
        return {"y": y}
