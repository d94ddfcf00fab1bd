"""Two arms coupled by a pair of controllers, as a scenario through the engine and the FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import RunError
from cosim.engine.engine import Engine
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.fmus.bilateral import Pair, controls, links

ARMS = ("master", "slave")
H = 1e-3
Q1, Q2 = [-pi / 3, -pi / 2], [-2 * pi / 3, pi / 3]
Q_H = np.array([3.5, 3.0])
CONSTANT = {"law": "constant", "delay": 0.75}
JITTER = {"law": "uniform", "low": 0.3, "high": 1.2, "hold": 0.03}
PLAYOUT = {"semantics": "playout", "playout": 1.2}


@dataclass(frozen=True)
class Trajectories:
    """Every signal at each tick, (n, m); `failure`: why it stopped before its end."""

    signals: Mapping[str, np.ndarray]
    failure: RunError | None

    def __getitem__(self, name: str) -> np.ndarray:
        return self.signals[name]

    @property
    def apart(self) -> np.ndarray:
        """Position of the one arm less that of the other, (n, 2), rad."""
        return self["master.q"] - self["slave.q"]


def document(
    pair: Pair,
    *,
    stop: float,
    delay: Mapping[str, Any] = CONSTANT,
    master: Mapping[str, Any] | None = None,
    slave: Mapping[str, Any] | None = None,
    seed: int = 0,
    **link: Any,
) -> dict[str, Any]:
    """The scenario of a pair; `master`, `slave`: parameters of the arms, `link`: of all links."""
    arms = {
        name: {
            "model": "fmus.models.planar2r",
            "start": {"q": q},
            "parameters": dict(parameters or {}),
            "inputs": {"tau": f"{name}_control.tau"},
        }
        for name, q, parameters in (("master", Q1, master), ("slave", Q2, slave))
    }
    return {
        "run": {"step": H, "stop": stop, "seed": seed},
        "components": {**arms, **controls(pair, ARMS)},
        "links": links(pair, ARMS, delay, **link),
    }


def grip(k_p: float, k_d: float) -> dict[str, Any]:
    """An operator's hand on an arm, solved inside it."""
    return {"k_p": k_p, "k_d": k_d, "q_h": Q_H.tolist()}


def execute(scenario: Mapping[str, Any]) -> Trajectories:
    """Run a scenario to its end, or until it fails."""
    plan = assemble(build(scenario, Path("test.toml")))
    rows = np.zeros((plan.ticks + 1, plan.n_signals))
    failure = None
    with Engine(plan) as engine:
        engine.initialize()
        try:
            engine.run(plan.ticks, rows)
        except RunError as error:
            failure = error
        n = engine.rows
    slots = plan.slots()
    return Trajectories(
        {name: rows[:n, s.start : s.start + s.size] for name, s in slots.items()}, failure
    )


def run(pair: Pair, **options: Any) -> Trajectories:
    """Run a pair; `options` as in :func:`document`."""
    return execute(document(pair, **options))


def last_outside(error: np.ndarray, tolerance: float = 0.05) -> float:
    """The time (s) from which on every entry of `error` (n, m) stays within `tolerance`."""
    outside = np.nonzero(np.abs(error).max(axis=1) >= tolerance)[0]
    return (int(outside[-1]) + 1) * H if len(outside) else 0.0


def effort(run: Trajectories) -> float:
    """Norm of the operator's torque over the run, N.m.s^0.5."""
    return float(np.sqrt((run["master.tau_h"] ** 2).sum() * H))
