"""A controller of one's own: a PD law with limited torque, 20 lines of code."""

import numpy as np

from cosim.base.component import Parameter, Port


class PD:
    """tau = k_p (q_d - q) - k_d dq, each joint within ±tau_max."""

    kind = "sampled"  # reads its inputs at t, its output holds until the next step
    inputs = (Port("q", (2,), "rad"), Port("dq", (2,), "rad/s"))
    outputs = (Port("tau", (2,), "N.m"),)
    parameters = (
        Parameter("k_p", (20.0,), (), "N.m/rad", "Stiffness"),
        Parameter("k_d", (12.0,), (), "N.m.s/rad", "Damping"),
        Parameter("q_d", (1.0, -0.5), (2,), "rad", "Where the arm shall go"),
        Parameter("tau_max", (15.0,), (), "N.m", "Limit of each joint's torque"),
    )

    def initialize(self, values):
        """Take the parameters of the scenario; those it leaves out keep their default."""
        self.p = {p.name: np.reshape(p.default, p.shape) for p in self.parameters} | dict(values)

    def initial(self, u):
        """Give the outputs at the start."""
        return self.step(0.0, 0.0, u)

    def step(self, t, h, u):
        """Give the outputs from t (s) to t + h."""
        p = self.p
        tau = p["k_p"] * (p["q_d"] - u["q"]) - p["k_d"] * u["dq"]
        return {"tau": np.clip(tau, -p["tau_max"], p["tau_max"])}
