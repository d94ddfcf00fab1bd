"""A recorded run as one offline run: no nodes, no buses, inputs as they were received.

The replay computes every node again. This module checks whether the scenario, as one program, gives
the same result. A link whose receiver held the samples that were sent uses its recorded table.
Every other input that crossed the cut uses the values that its node gave it: torques modified by
drives, values rounded by buses, samples of foreign senders. If a node told a controller the time
since the last sample, the controller receives the same time. The result therefore equals the
recorded run to the last bit, unless something was altered.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.cut import Inlet, NodePlan
from bridge.deployment.protection import age_slot
from bridge.deployment.system import System
from bridge.recording.run_folder import at_hits, places
from bridge.records.node_lives import Life
from bridge.wiring.wiring import Rows
from cosim.base.copies import replace
from cosim.base.errors import PlanError
from cosim.base.names import signal_of
from cosim.engine.memory_run import RepeatedValues
from cosim.engine.simulate import simulate
from cosim.scenario.assemble import assemble
from cosim.scenario.recorded import with_recorded_links
from cosim.schedule.parts import Player, Slot
from cosim.schedule.plan import Plan

#: Name in a run folder.
OFFLINE = "offline"


def run_offline(system: System, run: Path, rows: Mapping[Life, Rows]) -> Path:
    """Run the scenario with the inputs of the folder `run` into ``RUN/offline``; return its path.

    `rows`: the rows (slots,) of each life. Raises ScenarioError for a link that does not cross a
    cut, because it has no table.
    """
    try:
        plan = _recorded_plan(system, run, rows, recorded_inputs(system, rows))
    except PlanError:  # all in a loop held a sample of the very tick they were in
        plan = _recorded_plan(system, run, rows, _crossing(system))
    simulate(system.scenario, run / OFFLINE, plan=plan, force=True)
    return run / OFFLINE


def recorded_inputs(system: System, rows: Mapping[Life, Rows]) -> list[tuple[str, Inlet]]:
    """Return the inputs that use recorded values, by node: all except links that match fully.

    `rows`: the rows (slots,) of each life.
    """
    return [x for x in _crossing(system) if not _as_sent(system, rows, *x)]


def _crossing(system: System) -> list[tuple[str, Inlet]]:
    return [(node, inlet) for node, plan in system.nodes.items() for inlet in plan.inlets]


def _recorded_plan(
    system: System, run: Path, rows: Mapping[Life, Rows], inputs: Sequence[tuple[str, Inlet]]
) -> Plan:
    """The scenario's plan over the tables of `run`, these inputs fed from the rows."""
    players = [p for node, inlet in inputs for p in _players(system, rows, node, inlet)]
    there = {p.target.start for p in players}
    whole = assemble(system.scenario)
    wires = tuple(w for w in whole.wires if w.target.start not in there)
    links = tuple(x for x in whole.links if x.target.start not in there)
    told = [p for p in _silences(system, rows) if p.target.start not in there]
    return with_recorded_links(replace(whole, wires=wires, links=links), run, [*players, *told])


def _players(
    system: System, rows: Mapping[Life, Rows], node: str, inlet: Inlet
) -> Iterator[Player]:
    """Values given to an input at each step of its component; also the age from its link."""
    for slot in (inlet.target, *([inlet.age] if inlet.age else [])):
        for name, place, column in _entries(system, node, slot):
            values = _received_signal(system, rows, node, inlet, column)
            yield Player(replace(slot, name=name, start=place, shape=()), RepeatedValues(values))


def _entries(system: System, node: str, slot: Slot) -> Iterator[tuple[str, int, int]]:
    """(name, place in the whole plan's vector, place in the node's) of each entry of an input."""
    whole, own = places(system, system.nodes[node])
    where = dict(zip(own.tolist(), whole.tolist(), strict=True))
    for k, name in enumerate(slot.scalars()):
        yield name, where[slot.start + k], slot.start + k


def _received_signal(
    system: System, rows: Mapping[Life, Rows], node: str, inlet: Inlet, column: int
) -> NDArray[np.float64]:
    """A signal of an input at each hit, (hits,). A plant's row is written before it is given."""
    later = system.plan.component(inlet.component).kind == "continuous"

    def given(found: Rows) -> NDArray[Any]:
        values = np.asarray(found["signals"][:, column])
        return np.append(values[1:], values[-1:]) if later else values

    return at_hits(system, rows, node, inlet.ticks, given, 0.0)


def _as_sent(system: System, rows: Mapping[Life, Rows], node: str, inlet: Inlet) -> bool:
    """True if a link gave what its sender computed, sample by sample, none before it was sent."""
    if inlet.link is None:
        return False
    sender = next(n for n, p in system.nodes.items() if _has(p, inlet.source.name))
    sent_ticks = system.messages[inlet.message].outlet.ticks

    def held_of(found: Rows) -> NDArray[Any]:
        at = system.nodes[node].inlets.index(inlet)
        return np.asarray(found["inlets"]["held"][:, at])

    held = at_hits(system, rows, node, inlet.ticks, held_of, -1).astype(np.int64)
    if (held * sent_ticks > np.arange(held.size) * inlet.ticks).any():
        return False
    first = _source(system.nodes[sender], inlet.source)
    for k in range(inlet.target.size):
        sent = at_hits(system, rows, sender, sent_ticks, _column(first + k), 0.0)
        given = _received_signal(system, rows, node, inlet, inlet.target.start + k)
        if held.max() >= len(sent):
            return False
        first_value = sent[0] if inlet.link.initial is None else inlet.link.initial[k]
        values = np.where(held < 0, first_value, sent[np.maximum(held, 0)])
        if (inlet.gain * values + inlet.offset != given).any():
            return False
    return True


def _column(column: int) -> Callable[[Rows], NDArray[Any]]:
    return lambda found: np.asarray(found["signals"][:, column])


def _has(plan: NodePlan, name: str) -> bool:
    return any(step.name == name.partition(".")[0] for step in plan.plan.components)


def _source(plan: NodePlan, source: Slot) -> int:
    """The place of a slot of the whole plan in a node's vector."""
    for name, slot in plan.plan.slots().items():
        if source.name == name:
            return slot.start
        if source.name in slot.scalars():
            return slot.start + slot.scalars().index(source.name)
    raise KeyError(source.name)


def _silences(system: System, rows: Mapping[Life, Rows]) -> Iterator[Player]:
    """Ages of stale inputs that nodes gave their components, s, at each of their steps."""
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
    port = f"{inlet.component}.{signal_of(age)}"
    whole, k = system.plan.slots()[port], at - plan.plan.slots()[port].start

    def told(found: Rows) -> NDArray[Any]:
        return np.asarray(found["signals"][:, at])

    target = replace(whole, name=whole.scalars()[k], start=whole.start + k, shape=())
    return Player(target, RepeatedValues(at_hits(system, rows, node, inlet.ticks, told, 0.0)))
