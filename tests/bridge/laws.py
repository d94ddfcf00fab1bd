"""A controller that fails intentionally, with ports and parameters of fmus.models.teleoperation."""

from __future__ import annotations

import ctypes

import numpy as np

from cosim.base.component import Parameter, Port


class Law:
    """tau = -K q; after `t_bad` it raises, gives NaN (`nan` = 1), or calls exit(0) (`ends` = 1)."""

    kind = "sampled"
    inputs = (
        Port("q", (2,), "rad", "Position"),
        Port("dq", (2,), "rad/s", "Velocity"),
        Port("xi_in", (1, 2), "rad/s", "Received"),
        Port("age", (1,), "s", "Of what was received"),
    )
    outputs = (Port("tau", (2,), "N.m", "Torque"), Port("xi", (2,), "rad/s", "Sent"))
    parameters = (
        *(
            Parameter(name, (0.0,), (), unit, "Not used")
            for name, unit in (
                *((name, "1") for name in ("Gamma", "alpha", "lambda", "lambda_M")),
                *((name, "s") for name in ("age_max", "age_fade")),
                ("tau_max", "N.m"),
            )
        ),
        Parameter("K", (16.0,), (), "N.m/rad", "Stiffness"),
        Parameter("t_bad", (1e9,), (), "s", "When it fails"),
        Parameter("nan", (0.0,), (), "1", "1: NaN instead of an exception"),
        Parameter("ends", (0.0,), (), "1", "1: exit(0) instead of an exception"),
    )

    def initialize(self, values):
        self.K, self.t_bad = values.get("K", 16.0), values.get("t_bad", 1e9)
        self.nan, self.ends = values.get("nan", 0.0), values.get("ends", 0.0)

    def initial(self, u):
        return {"tau": -self.K * u["q"], "xi": u["dq"] + 0.5 * u["q"]}

    def step(self, t, h, u):
        y = self.initial(u)
        if t < self.t_bad - h / 2:
            return y
        if self.ends:
            ctypes.CDLL(None).exit(0)
        if not self.nan:
            raise RuntimeError("on purpose")
        return {**y, "tau": np.full(2, np.nan)}

    def get_state(self):
        return None

    def set_state(self, state):
        pass
