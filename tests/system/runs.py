"""The teleoperator of ``configs/teleoperation.toml`` as a document to vary, and its runs."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cosim.engine.engine import Engine
from cosim.engine.simulate import simulate
from cosim.measure.metrics import settle_time
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from cosim.schedule.plan import Plan

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "configs" / "teleoperation.toml"
Q_H = np.array([3.5, 3.0])
SIDES = {"master": "slave", "slave": "master"}

Document = dict[str, Any]


def teleoperation(*, stop: float = 60.0, seed: int = 0, lambda_M: float = 10.0) -> Document:
    """The shipped scenario, without what is only printed or drawn."""
    document = tomllib.loads(CONFIG.read_text(encoding="utf-8"))
    document["run"] |= {"stop": stop, "seed": seed}
    for side in SIDES:
        document["components"][f"{side}_control"]["parameters"]["lambda_M"] = lambda_M
    for key in ("metrics", "require", "figures"):
        del document[key]
    return document


def without_delay(document: Document) -> Document:
    """xi goes to the other controller in the tick it is measured in, through ``fmus.models.xi``."""
    components = document["components"]
    for side, other in SIDES.items():
        inputs = {"q": f"{side}.q", "dq": f"{side}.dq"}
        xi = {"model": "fmus.models.xi", "period": "5 ms", "inputs": inputs}
        components[f"{side}_xi"] = xi
        components[f"{other}_control"]["inputs"]["xi_in[0]"] = f"{side}_xi.xi"
    return document | {"links": []}


def scenario(document: Document, path: Path = CONFIG) -> Scenario:
    """The scenario in a document; files in it are relative to `path`."""
    return build(document, path)


def plan(document: Document, path: Path = CONFIG) -> Plan:
    """The plan of a document."""
    return assemble(scenario(document, path))


def run(
    document: Document, folder: Path, further: Mapping[str, Any] | None = None, path: Path = CONFIG
) -> Run:
    """Run a document into `folder`, with `further` entries of ``run.json``, and open it."""
    return Run.open(simulate(scenario(document, path), folder, further=further).folder)


def signals(made: Plan) -> np.ndarray:
    """Everything the engine records of a plan, (ticks + 1, n_signals)."""
    with Engine(made) as engine:
        engine.initialize()
        rows = np.empty((made.ticks + 1, made.n_signals))
        engine.run(made.ticks, rows)
        rows[-1] = engine.signals
    return rows


def settled(result: Run) -> float:
    """Time, s, from which every joint of both arms stays within 0.05 rad of q_h."""
    error = np.hstack([result.array(f"{side}.q") - Q_H for side in SIDES])
    return settle_time(np.abs(error).max(axis=1), result.t, 0.05)


def effort(result: Run) -> float:
    """‖τ_h‖₂ over the run, N.m.√s."""
    squared = (result.array("master.tau_h") ** 2).sum(axis=1)
    return float(np.sqrt(squared[:-1] @ np.diff(result.t)))
