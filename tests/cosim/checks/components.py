"""A component that offers no facts."""

from __future__ import annotations

import numpy as np

from cosim.base.component import Kind, Outputs, Port, Values


class Nothing:
    """Sampled: no torque."""

    kind: Kind = "sampled"
    inputs = ()
    outputs = (Port("y", (2,), "N.m"),)
    parameters = ()

    def initialize(self, values: Values) -> None:
        """Nothing to take."""

    def initial(self, u: Values) -> Outputs:
        return {"y": np.zeros(2)}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        return {"y": np.zeros(2)}

    def get_state(self) -> object:
        return None

    def set_state(self, state: object) -> None:
        del state
