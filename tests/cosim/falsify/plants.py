"""Loops with known stability limits, as components and scenarios."""

from __future__ import annotations

import os
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


class Side:
    """Sampled: a mass m on a line, m ddq = -K (q - q_j) - B dq - D (dq - dq_j), forces held.

    What is received, q_j and dq_j, is of the other side, and late.
    """

    kind = "sampled"
    inputs = (Port("q_j"), Port("dq_j"))
    outputs = (Port("q"), Port("dq"))
    parameters = tuple(
        Parameter(name, (value,))
        for name, value in (
            ("q", 1.0),
            ("dq", 0.0),
            ("m", 1.0),
            ("K", 10.0),
            ("B", 3.0),
            ("D", 0.0),
        )
    )

    def initialize(self, values: Any) -> None:
        self.x = [float(values.get("q", 1.0)), float(values.get("dq", 0.0))]
        self.gains = [float(values[name]) for name in ("m", "K", "B", "D")]

    def initial(self, u: Any) -> Any:
        return {"q": self.x[0], "dq": self.x[1]}

    def step(self, t: float, h: float, u: Any) -> Any:
        (q, dq), (m, K, B, D) = self.x, self.gains
        a = -(K * (q - float(u["q_j"])) + B * dq + D * (dq - float(u["dq_j"]))) / m
        self.x = [q + h * dq + 0.5 * h * h * a, dq + h * a]
        return {"q": self.x[0], "dq": self.x[1]}

    def get_state(self) -> Any:
        return list(self.x)

    def set_state(self, state: Any) -> None:
        self.x = list(state)


def pair(longest: float, stop: float, sample: float, **gains: float) -> Document:
    """Two sides with samples every `sample` (s), whose delays are up to `longest` (s).

    They begin 2 m apart. Their motion has to decay: its swing in the last quarter of the run is
    less than in the last half.
    """
    delay = {"law": "uniform", "low": sample, "high": longest + sample, "hold": sample}
    sides = {
        name: {
            "model": "tests.cosim.falsify.plants:Side",
            "period": sample,
            "parameters": {"q": q, **gains},
        }
        for name, q in (("a", 1.0), ("b", -1.0))
    }
    links = [
        {"from": f"{x}.{s}", "to": f"{y}.{s}_j", "delay": delay, "channel": f"{x} to {y}"}
        for x, y in (("a", "b"), ("b", "a"))
        for s in ("q", "dq")
    ]
    swing = {"kind": "vibration", "of": ["a.q", "b.q"]}
    return {
        "run": {"step": sample, "stop": stop},
        "components": sides,
        "links": links,
        "metrics": {
            "late": {**swing, "window": stop / 4},
            "half": {**swing, "window": stop / 2},
        },
        "require": {"decays": {"metric": "late <= 0.999 * half + 1e-6"}},
    }


class Brittle(Decay):
    """A loop whose process ends once x has overshot far: a crash."""

    def step(self, t: float, h: float, u: Any) -> Any:
        found = super().step(t, h, u)
        if self.x < -0.25:
            os._exit(3)
        return found
