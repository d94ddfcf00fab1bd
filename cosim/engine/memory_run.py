"""Runs in memory: a plan with changed values and additional forces, and its recorded signals.

An experiment is a plan like any other, through the same engine and the same components; only that
nothing is written. Forces are played from tables, in the same way as the weights of edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct, field
from cosim.base.copies import replace
from cosim.base.errors import RunError, ScenarioError
from cosim.engine.engine import Engine
from cosim.scenario.connect import unknown
from cosim.schedule.parts import Player, Slot, Step
from cosim.schedule.plan import Plan, compile_plan

Array = NDArray[np.float64]
#: Values that are recorded at once, and ticks.
_CHUNK, _TICKS = 1 << 18, 8192


class SignalTrace(Struct, frozen=True):
    """Samples recorded of some signals; `stopped`: the reason why it ended early, or "".

    `t` (n,) s; the rest is as for a run read back from its folder.
    """

    t: Array
    columns: Mapping[str, Array]
    units: Mapping[str, str]
    names: Mapping[str, tuple[str, ...]]
    stopped: str = ""

    @property
    def constant(self) -> bool:
        """True if no signal changes."""
        return all((x == x[0]).all() for x in self.columns.values())

    def less(self, other: SignalTrace) -> SignalTrace:
        """The same, the signals of `other` subtracted; both have as many rows."""
        rest = {name: self.columns[name] - x for name, x in other.columns.items()}
        return replace(self, columns={**self.columns, **rest})

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m). Raises ScenarioError for one that was not recorded."""
        if prefix not in self.columns:
            raise ScenarioError(unknown(prefix, self.columns, "recorded signal"))
        return self.columns[prefix]

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of those entries."""
        self.array(prefix)
        return self.names[prefix]

    def unit(self, prefix: str) -> str:
        """Unit of a signal."""
        self.array(prefix)
        return self.units[prefix]


def trace(plan: Plan, signals: Sequence[str], every: int = 1) -> SignalTrace:
    """Run a plan from its start, recording each `every`-th tick of `signals`.

    A run that has to stop is not an error here: what there is until then comes back.
    """
    slots = plan.slots()
    chosen = {name: slots[name] for name in signals}
    index = [np.arange(s.start, s.start + s.size) for s in chosen.values()]
    at = np.concatenate(index) if index else np.empty(0, np.intp)
    rows = every * max(1, min(_CHUNK // max(1, len(at)), _TICKS // every, plan.ticks // every + 1))
    buffer = np.empty((rows, len(at)))  # of which a row in `every` is filled in
    x, kept = np.empty((plan.ticks // every + 2, len(at))), 0
    stopped = ""
    with Engine(plan, columns=at.tolist(), every=every) as engine:
        engine.initialize()
        while engine.tick < plan.ticks and not stopped:
            try:
                n = engine.run(min(rows, plan.ticks - engine.tick), buffer)
            except RunError as error:
                stopped, n = str(error), engine.rows
            found = buffer[:n:every]
            x[kept : kept + len(found)] = found
            kept += len(found)
            stopped = stopped or str(engine.ended or "")
        if not stopped and plan.ticks % every == 0:
            x[kept] = engine.signals[at]
            kept += 1
    x = x[:kept]
    columns, first = {}, 0
    for name, slot in chosen.items():
        columns[name] = x[:, first : first + slot.size]
        first += slot.size
    return SignalTrace(
        plan.start + plan.h * (every * np.arange(len(x), dtype=np.float64)),
        columns,
        {name: s.unit for name, s in chosen.items()},
        {name: s.scalars() for name, s in chosen.items()},
        stopped,
    )


# ---- plans that differ a little -----------------------------------------------------------------


class RepeatedValues(Struct, frozen=True):
    """Values, (n,), one a hit of the receiver, again from the start after the last."""

    values: Array

    def stream(self) -> _Playing:
        """The recorded values from the first one on."""
        return _Playing(self.values)

    def facts(self) -> dict[str, Any]:
        """The number of recorded values, as plain data."""
        return {"values": len(self.values)}


class _Playing:
    def __init__(self, values: Array) -> None:
        self._values, self._next = values, 0

    def rows(self, n: int) -> Array:
        """The next `n` values."""
        at = np.arange(self._next, self._next + n) % len(self._values)
        self._next += n
        return self._values[at]


class Change(Struct, frozen=True):
    """The changes of an experiment.

    `values`: parameters and start values by component; `forces`: values of an input, (n, m) for its
    m entries, by the input's name, in place of its sources; `seconds`: duration of the run, s.
    """

    seconds: float
    values: Mapping[str, Mapping[str, Sequence[float]]] = field(default_factory=dict)
    forces: Mapping[str, Array] = field(default_factory=dict)

    def merged(self, **values: Mapping[str, Sequence[float]]) -> Change:
        """With further values by component."""
        together = dict(self.values)
        for name, given in values.items():
            together[name] = {**together.get(name, {}), **given}
        return replace(self, values=together)


def changed(plan: Plan, change: Change) -> Plan:
    """The plan with a change. Raises ScenarioError for names that are not there."""
    slots = plan.slots()
    for name in change.forces:
        if name not in slots:
            raise ScenarioError(unknown(name, slots, "signal"))
    taken = [slots[name] for name in change.forces]
    players = [
        Player(_scalar(slots[name], i), RepeatedValues(np.ascontiguousarray(values[:, i])))
        for name, values in change.forces.items()
        for i in range(slots[name].size)
    ]
    steps = [_step(step, change.values.get(step.name, {})) for step in plan.components]
    return compile_plan(
        plan.h,
        max(1, round(change.seconds / plan.h)),
        steps,
        [w for w in plan.wires if not _hits(w.target, taken)],
        [x for x in plan.links if not _hits(x.target, taken)],
        plan.algorithm,
        [*(p for p in plan.players if not _hits(p.target, taken)), *players],
        plan.later if plan.algorithm == "gauss-seidel" else (),
        adaptive=plan.adaptive,
        start=plan.start,
    )


def _step(step: Step, given: Mapping[str, Sequence[float]]) -> Step:
    if not given:
        return step
    parameters = {p.name: p.size for p in step.component.parameters}
    inputs = {p.name: p.size for p in step.component.inputs}
    values, start = dict(step.values), dict(step.start)
    for name, value in given.items():
        if name not in parameters and name not in inputs:
            what = f"parameter or input of {step.name}"
            raise ScenarioError(unknown(name, [*parameters, *inputs], what))
        where, size = (values, parameters) if name in parameters else (start, inputs)
        where[name] = tuple(float(x) for x in np.broadcast_to(value, (size[name],)))
    return replace(step, values=values, start=start)


def _scalar(slot: Slot, i: int) -> Slot:
    return replace(slot, name=slot.scalars()[i], start=slot.start + i, shape=())


def _hits(target: Slot, taken: Sequence[Slot]) -> bool:
    return any(
        t.start < target.start + target.size and target.start < t.start + t.size for t in taken
    )
