"""Loops with known stability limits, as components and scenarios."""

from __future__ import annotations

from typing import Any

from cosim.base.component import Parameter, Port

Document = dict[str, Any]


class Decay:
    """Sampled: x[k+1] = x[k] - a u[k]; u is x, late."""

    kind = "sampled"
    inputs = (Port("u"),)
    outputs = (Port("x"),)
    parameters = (Parameter("x", (1.0,)), Parameter("a", (0.1,)))

    def initialize(self, values: Any) -> None:
        self.x, self.a = float(values.get("x", 1.0)), float(values.get("a", 0.1))

    def initial(self, u: Any) -> Any:
        return {"x": self.x}

    def step(self, t: float, h: float, u: Any) -> Any:
        self.x -= self.a * float(u["u"])
        return {"x": self.x}

    def get_state(self) -> Any:
        return self.x

    def set_state(self, state: Any) -> None:
        self.x = state


def integrator(a: float, longest: int, stop: float) -> Document:
    """x[k+1] = x[k] - a x[k - d[k]], 0 <= d[k] <= `longest`, a sample a second.

    Stable for all such d if a (longest + 1) < 3/2 + 1/(2 (longest + 1)). (What is sent in a step is
    there in the next one, so that the delay of the link is d[k] + 1 samples.)
    """
    delay = {"law": "uniform", "low": 1.0, "high": float(longest + 1), "hold": 1.0}
    return {
        "run": {"step": 1.0, "stop": stop},
        "components": {
            "one": {"model": "tests.cosim.falsify.plants:Decay", "parameters": {"a": a}},
        },
        "links": [{"from": "one.x", "to": "one.u", "delay": delay}],
        "require": {"decays": {"always": "abs(one.x) < 0.9", "after": 0.9 * stop}},
    }
