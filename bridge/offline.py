"""A recorded run as one offline run: no nodes, no buses, its link tables in place of the network.

The replay computes every node again as it was; this asks what the cut into nodes, codecs, guards
and late slots have changed. Links hold what their receivers held, and where a node told a
controller for how long it had heard nothing, the controller is told the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.collect import at_hits
from bridge.cut import Inlet
from bridge.lives import Life
from bridge.protect import age_slot
from bridge.system import System
from bridge.wiring import Rows
from cosim.analysis.trace import Played
from cosim.assemble import assemble
from cosim.errors import PlanError, ScenarioError
from cosim.plan import Player
from cosim.recorded import over
from cosim.simulate import simulate

#: Name in a run folder.
OFFLINE = "offline"


def run_offline(system: System, run: Path, rows: Mapping[Life, Rows]) -> Path:
    """Run the scenario over the tables of the run folder `run` into ``RUN/offline``; returns it.

    `rows`: of the journals, by life. Raises ScenarioError where a link did not cross a cut (it has
    no table), where a sample was held before it was sent, as clocks that differ make it look, or
    where two nodes both held samples of the very tick they were in, as no order of them allows.
    """
    scenario = system.scenario
    try:
        plan = over(assemble(scenario), run, _silences(system, rows))
    except PlanError as error:
        raise ScenarioError(
            "nodes were so late that all in a loop held a sample of the very tick they were in; "
            f"one offline run steps one after the other ({str(error).partition('. ')[0]})",
            str(run),
        ) from None
    simulate(scenario, run / OFFLINE, plan=plan, force=True)
    return run / OFFLINE


def _silences(system: System, rows: Mapping[Life, Rows]) -> Iterator[Player]:
    """What nodes told their components of stale inputs, s, at each hit of these."""
    for node, plan in system.nodes.items():
        for inlet in plan.inlets:
            stale = system.deployment.nodes[node].stale
            spec = stale.get(f"{inlet.component}.{inlet.target.port}")
            if spec is not None and spec.age:
                yield _silence(system, rows, node, inlet, spec.age)


def _silence(
    system: System, rows: Mapping[Life, Rows], node: str, inlet: Inlet, age: str
) -> Player:
    plan = system.nodes[node]
    at = age_slot(plan, inlet, age, str(system.deployment.path))
    port = f"{inlet.component}.{age.partition('[')[0]}"
    whole, k = system.plan.slots()[port], at - plan.plan.slots()[port].start

    def told(found: Rows) -> NDArray[Any]:
        return np.asarray(found["signals"][:, at])

    target = replace(whole, name=whole.scalars()[k], start=whole.start + k, shape=())
    return Player(target, Played(at_hits(system, rows, node, inlet.ticks, told, 0.0)))
