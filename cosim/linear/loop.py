"""The linear model of a plan at a time: its operations over one period, with matrices for steps.

Every signal, state and sample in flight is a row of factors of what there was at the start of the
period and of the inputs. The operations of the plan copy, send and receive these rows; a step
multiplies them by the derivatives of its component. So rates, order and delays are those of the
run; a link that jumps has the delays of this one period.
With links cut (:mod:`cosim.linear.opened`) what is held is an input, what is sent an output.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from math import lcm
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.engine.tables import LinkRows
from cosim.fmi.components import model_name
from cosim.linear.component import Matrix, StepDerivatives, step_derivatives
from cosim.native.enums import Code
from cosim.schedule.operations import Operation
from cosim.schedule.parts import Slot, Step
from cosim.schedule.plan import Plan

#: What has a linear counterpart here.
_KNOWN = {Code.COPY, Code.SCALE, Code.PUSH, Code.PULL, Code.STEP, Code.RECORD, Code.AGE, Code.PLAY}

#: States, signals and values in flight at the most: matrices of more fill the memory.
MOST = 8000


class OperatingPoint(Struct, frozen=True):
    """The point at which a plan is linearized: `tick`, the first of a period of `ticks` ticks.

    `signals`: rows of the signal vector, (ticks + 1, n_signals), before each tick and at the end;
    `tables`: the numbers of the samples that each link holds at its hits in the period.
    """

    tick: int
    ticks: int
    signals: Matrix
    tables: Mapping[str, Sequence[int]]


def operating_point(plan: Plan, time: float) -> OperatingPoint:
    """Run `plan` to the period that contains `time` (s). Raises ScenarioError, RunError."""
    period = lcm(*(c.period for c in plan.components))
    if not plan.start <= time <= plan.end:
        raise ScenarioError(
            f"--at {time:g}: expected a time of the run, {plan.start:g} to {plan.end:g} s"
        )
    begin = int((time - plan.start) / plan.h + 1e-6) // period * period
    found: list[LinkRows] = []
    rows = []
    with Engine(plan, found.append) as engine:
        engine.initialize()
        engine.run(begin)
        for _ in range(period):
            rows.append(engine.signals.copy())
            engine.run(1)
        rows.append(engine.signals.copy())
        if engine.ended is not None:
            raise ScenarioError(f"the run is {engine.ended}, expected it to reach {time:g} s")
    return OperatingPoint(begin, period, np.array(rows), _held(plan, found, begin))


def _held(plan: Plan, found: Sequence[LinkRows], begin: int) -> dict[str, list[int]]:
    """The rows of each link's table from the tick `begin` on. `found`: all rows from tick 0 on, in
    the pieces in which they were drawn: a piece begins before the period, and may end in it.
    """
    parts = list(zip(*(piece.parts() for piece in found), strict=True))
    tables = {link.name: list[int]() for link in plan.links}
    for o in plan.operations:
        if o.code is Code.PULL and parts:
            hits = len(range(o.first, begin, o.period))
            rows = np.concatenate(parts[o.index])[hits:]
            tables[plan.links[o.index].name] = rows.tolist()
    return tables


class CutLink(Struct, frozen=True):
    """A link that is cut: some inputs of a loop stand for what is held, some outputs for what is
    sent.

    In a period of the loop its receiver looks every `look` ticks, r times, and its sender sends
    every `send` ticks, s times. `held` (r, w) and `sent` (s, w): the places of its w numbers among
    the inputs and outputs of the loop, both in the unit of the receiver.
    """

    name: str
    look: int
    send: int
    held: NDArray[np.intp]
    sent: NDArray[np.intp]


def _cut_links(plan: Plan, ticks: int) -> tuple[CutLink, ...]:
    found, first, last = [], 0, 0
    for link in plan.links:
        look, send = (plan.component(s.component).period for s in (link.target, link.source))
        w = link.source.size
        held = np.arange(first, first + ticks // look * w).reshape(-1, w)
        sent = np.arange(last, last + ticks // send * w).reshape(-1, w)
        first, last = first + held.size, last + sent.size
        found.append(CutLink(link.name, look, send, held, sent))
    return tuple(found)


class LinearLoop(Struct, frozen=True):
    """z+ = `F` z + `G` u and y = `H` z + `J` u over a period (s), in the units of the signals.

    `names` and `units` are those of z: first the `n_states` states of components, then held
    signals and samples in flight. y is what a recorded row has at the start of the period.
    """

    period: float
    names: tuple[str, ...]
    units: tuple[str, ...]
    n_states: int
    n_held: int
    F: Matrix
    G: Matrix
    H: Matrix
    J: Matrix
    components: tuple[StepDerivatives, ...]


def linear_loop(
    plan: Plan,
    at: OperatingPoint,
    inputs: Sequence[Slot],
    outputs: Sequence[Slot],
    size: float,
    only: str = "",
    say: Callable[[str], None] = lambda text: None,
) -> LinearLoop:
    """The linear model from `inputs`, added to what arrives there and held for a period.

    `size`: the change of a value for the differences, in the unit of its signal up to 1 and
    relative above; `only`: of this component alone. Raises RunError and ScenarioError.
    """
    _check(plan, only)
    models = {}
    for i, step in enumerate(plan.components):
        if only in ("", step.name):
            say(step.name)
            seen, h = _seen(plan, at, step), step.period * plan.h
            models[i] = step_derivatives(step, seen, plan.time(at.tick), h, size)
    return _Period(plan, at, models, inputs, only).run(outputs)


#: Derivatives that were made before, by what they are a function of.
KnownDerivatives: TypeAlias = dict[Hashable, StepDerivatives]


def cut_loop(
    plan: Plan,
    at: OperatingPoint,
    inputs: Sequence[Slot],
    outputs: Sequence[Slot],
    size: float,
    known: KnownDerivatives | None = None,
) -> tuple[LinearLoop, tuple[CutLink, ...]]:
    """The linear model with all links cut, of one difference of `size` for each value.

    `size` is in the unit of a value up to 1, and relative above.
    Before `inputs` come the values that receivers hold, before `outputs` those that are sent. What
    is in `known` is not made again, and what is made comes into it. Raises RunError and
    ScenarioError.
    """
    _check(plan, "")
    fed = np.zeros(plan.n_signals, bool)
    for o in plan.operations:
        if o.code in (Code.COPY, Code.SCALE, Code.PULL):
            fed[o.target : o.target + o.count] = True
    for slot in inputs:
        fed[slot.start : slot.start + slot.size] = True
    made: KnownDerivatives = {} if known is None else known
    models = {
        i: _once(
            step, _seen(plan, at, step), (plan.time(at.tick), step.period * plan.h, size), fed, made
        )
        for i, step in enumerate(plan.components)
    }
    links = _cut_links(plan, at.ticks)
    return _Period(plan, at, models, inputs, "", links).run(outputs), links


def _once(
    step: Step,
    seen: tuple[Matrix, Matrix, Matrix],
    numbers: tuple[float, float, float],
    fed: NDArray[np.bool_],
    made: KnownDerivatives,
) -> StepDerivatives:
    """The derivatives of a step, or those of another one of the same model in the same state.

    `numbers`: its time and its length (s), and the size.
    """
    ports = [slice(s.start, s.start + s.size) for s in (*step.inputs, *step.outputs)]
    own = b"".join(x[p].tobytes() for x in (*seen, fed) for p in ports)
    model = model_name(step.component)
    key = (model, step.kind, tuple(sorted(step.values.items())), own, numbers)
    if key not in made:
        made[key] = step_derivatives(step, seen, *numbers, fed=fed)
    slots = {s.port: s for s in step.outputs}
    states = tuple(slots[s.port] for s in made[key].states)
    return replace(made[key], name=step.name, states=states)


def _seen(plan: Plan, at: OperatingPoint, step: Step) -> tuple[Matrix, Matrix, Matrix]:
    end = at.signals[1 if step.kind == "sampled" else step.period]
    if step.name not in plan.order:
        end = at.signals[step.period]
    return at.signals[0], at.signals[1], end


def _check(plan: Plan, only: str) -> None:
    unknown = {o.code for o in plan.operations} - _KNOWN
    if unknown and not only:
        what = "signals over a simulated bus" if Code.GATE in unknown else "extrapolated inputs"
        what = "macro steps (adaptive)" if Code.MACRO in unknown else what
        raise ScenarioError(
            f"the scenario has {what}, which have no linear model here; expected wires and links"
        )


class _Period:
    """The rows of one period. Columns: z, then the inputs."""

    def __init__(
        self,
        plan: Plan,
        at: OperatingPoint,
        models: Mapping[int, StepDerivatives],
        inputs: Sequence[Slot],
        only: str,
        cut: tuple[CutLink, ...] | None = None,
    ) -> None:
        self._plan, self._at, self._models, self._cut = plan, at, models, cut
        chosen = [o for o in plan.operations if _belongs(o, models, only)]
        self._operations = chosen
        self._n_x = sum(m.x0.size for m in models.values())
        closed = not only and cut is None
        self._depths = [_depth(plan, at, i) for i in range(len(plan.links) if closed else 0)]
        self._n_flight = sum(
            d * x.source.size for d, x in zip(self._depths, plan.links, strict=False)
        )
        self._n_z = self._n_x + plan.n_signals + self._n_flight
        _check_size(self._n_z, self._n_flight)
        n_held = sum(c.held.size for c in cut or ())
        self._width = self._n_z + n_held + sum(s.size for s in inputs)
        self._added = np.zeros((plan.n_signals, self._width))
        self._held = np.eye(n_held, self._width, self._n_z)
        self._sent = np.zeros((sum(c.sent.size for c in cut or ()), self._width))
        first = self._n_z + n_held
        for slot in inputs:
            for i in range(slot.size):
                self._added[slot.start + i, first + i] = 1.0
            first += slot.size
        unit = np.eye(self._n_z, self._width)
        self._x = dict(self._split(unit))
        self._signals = unit[self._n_x : self._n_x + plan.n_signals]
        self._unfed()
        self._samples = self._flights(unit[self._n_x + plan.n_signals :])

    def _split(self, unit: Matrix) -> list[tuple[int, Matrix]]:
        found, first = [], 0
        for i, model in self._models.items():
            found.append((i, unit[first : first + model.x0.size].copy()))
            first += model.x0.size
        return found

    def _unfed(self) -> None:
        """Inputs that nothing feeds do not change, and neither do signals of others."""
        written = np.zeros(self._plan.n_signals, bool)
        for o in self._operations:
            if o.code in (Code.COPY, Code.SCALE, Code.PULL):
                written[o.target : o.target + o.count] = True
        for i in self._models:
            for slot in self._plan.components[i].outputs:
                written[slot.start : slot.start + slot.size] = True
        self._signals[~written] = 0.0

    def _flights(self, rows: Matrix) -> list[dict[int, Matrix]]:
        """Samples on their way at the start, by their number, of each link."""
        found, first = [], 0
        for depth, link in zip(self._depths, self._plan.links, strict=False):
            last = self._at.tick // self._plan.component(link.source.component).period - 1
            width, samples = link.source.size, {}
            for j in range(depth):
                samples[last - j] = rows[first : first + width]
                first += width
            found.append(samples)
        return found

    def run(self, outputs: Sequence[Slot]) -> LinearLoop:
        """All operations of the period."""
        self._hits = [0] * len(self._plan.links)
        recorded = self._signals
        for tick in range(self._at.ticks):
            for o in self._operations:
                if (tick - o.first) % o.period == 0:
                    self._do(o, tick)
                    if o.code is Code.RECORD and tick == 0:
                        recorded = self._signals.copy()
        rows = [*self._x.values(), self._signals, *self._arrived()]
        after = np.concatenate(rows)
        places = [np.zeros(0, np.intp), *(np.arange(s.start, s.start + s.size) for s in outputs)]
        y, n = np.concatenate([self._sent, recorded[np.concatenate(places)]]), self._n_z
        names, units = self._names()
        return LinearLoop(
            self._at.ticks * self._plan.h, names, units, self._n_x, self._plan.n_signals,
            after[:, :n], after[:, n:], y[:, :n], y[:, n:], tuple(self._models.values()),
        )  # fmt: skip

    def _do(self, o: Operation, tick: int) -> None:
        s = self._signals
        target = slice(o.target, o.target + o.count)
        source = slice(o.source, o.source + o.count)
        if o.code in (Code.COPY, Code.SCALE):
            s[target] = o.gain * s[source]
        elif o.code in (Code.PUSH, Code.PULL) and self._cut is not None:
            link, number = self._cut[o.index], tick // o.period
            if o.code is Code.PULL:
                s[target] = self._held[link.held[number]]
            else:
                self._sent[link.sent[number]] = o.gain * s[source]
        elif o.code is Code.PUSH:
            number = (self._at.tick + tick) // o.period
            self._samples[o.index][number] = o.gain * s[source]
        elif o.code is Code.PULL:
            row = self._at.tables[self._plan.links[o.index].name][self._hits[o.index]]
            self._hits[o.index] += 1
            s[target] = self._samples[o.index][row] if row >= 0 else 0.0
        elif o.code is Code.STEP:
            self._step(o.index)

    def _step(self, index: int) -> None:
        model, step, s = self._models[index], self._plan.components[index], self._signals
        places = [np.arange(p.start, p.start + p.size) for p in step.inputs]
        fed = np.concatenate([np.zeros(0, np.intp), *places])
        x, u = self._x[index], s[fed] + self._added[fed]
        self._x[index], y = model.A @ x + model.B @ u, model.C @ x + model.D @ u
        first = 0
        for slot in step.outputs:
            s[slot.start : slot.start + slot.size] = y[first : first + slot.size]
            first += slot.size

    def _arrived(self) -> list[Matrix]:
        """Samples on their way at the end of the period."""
        found = []
        for depth, link, samples in zip(
            self._depths, self._plan.links, self._samples, strict=False
        ):
            period = self._plan.component(link.source.component).period
            last = (self._at.tick + self._at.ticks) // period - 1
            found += [samples[last - j] for j in range(depth)]
        return found

    def _names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        named = [(n, s.unit) for m in self._models.values() for s in m.states for n in s.scalars()]
        held = [("", "1")] * self._plan.n_signals
        for c in self._plan.components:
            for s in (*c.inputs, *c.outputs):
                for i, n in enumerate(s.scalars()):
                    held[s.start + i] = (f"{n} (held)", s.unit)
        flights = [
            (f"{n} ({j + 1} before, link {link.name})", link.source.unit)
            for depth, link in zip(self._depths, self._plan.links, strict=False)
            for j in range(depth)
            for n in link.source.scalars()
        ]
        names, units = zip(*(named + held + flights), strict=True)
        return names, units


def _check_size(n_z: int, n_flight: int) -> None:
    if n_z > MOST:
        raise ScenarioError(
            f"the loop has {n_z} states and signals, {n_flight} of them values on their way over "
            f"links; expected at most {MOST}: shorten the delays with --set, or take one "
            "--component"
        )


def _belongs(o: Operation, models: Mapping[int, StepDerivatives], only: str) -> bool:
    if not only:
        return True
    return o.code is Code.RECORD or (o.code is Code.STEP and o.index in models)


def _depth(plan: Plan, at: OperatingPoint, index: int) -> int:
    """The number of samples sent before the period that a link still needs in it."""
    link = plan.links[index]
    sent = at.tick // plan.component(link.source.component).period
    held = [row for row in at.tables[link.name] if row >= 0]
    return max(0, sent - min(held, default=sent))
