"""Python components of the system tests."""

from __future__ import annotations

import numpy as np

from cosim.base.component import Kind, Outputs, Parameter, Port, Values


class LettingGo:
    """An operator with a spring and a damper who lets go of the robot at the time `until`, s."""

    kind: Kind = "sampled"
    inputs = (Port("q", (2,), "rad"), Port("dq", (2,), "rad/s"))
    outputs = (Port("tau_h", (2,), "N.m"),)
    parameters = (Parameter("until", (3.0,), (), "s"),)

    def initialize(self, values: Values) -> None:
        self.until = float(values.get("until", np.array(3.0)))

    def initial(self, u: Values) -> Outputs:
        return self.step(0.0, 0.0, u)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        holds = t < self.until
        return {"tau_h": 10.0 * ([3.5, 3.0] - u["q"]) - 5.0 * u["dq"] if holds else np.zeros(2)}
