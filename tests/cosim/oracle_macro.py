"""Macro steps of the oracle: one group over one period, in plain Python (``macro_steps.c``)."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cosim.engine.feedthrough import direct_outputs
from cosim.fmi.components import jumping_outputs
from cosim.schedule.macro import MacroGroup
from cosim.schedule.order import sequence, strongly_connected
from cosim.schedule.plan import Plan


class Secants:
    """y = g(y) by the passes so far: what the next one takes, and how far they are apart."""

    def __init__(self, fed: int, scale: Sequence[float]) -> None:
        self.fed, self.scale, self.kept = fed, scale, []  # (direction, change, its square)
        self.last = None

    def next(self, taken, found) -> tuple[list[float], float]:
        fed = self.fed
        r = [(b - a) / s for a, b, s in zip(taken, found, self.scale, strict=True)]
        residual = r[:fed]
        if self.last is not None:
            self.keep(residual, found)
        self.last = list(residual), list(found)
        chosen = list(found)
        for direction, change, size in self.kept:
            along = _dot(direction, residual) / size
            residual = _less(residual, along, direction)
            chosen = _less(chosen, along, change)
        jump = [(b - a) / s for a, b, s in zip(chosen, found, self.scale, strict=True)]
        return chosen, max(abs(x) for x in (*r, *jump))

    def keep(self, residual, found) -> None:
        if len(self.kept) == min(self.fed, 20):
            self.kept = []
        direction = [a - b for a, b in zip(residual, self.last[0], strict=True)]
        change = [a - b for a, b in zip(found, self.last[1], strict=True)]
        least = 1e-20 * (_dot(direction, direction) + _dot(residual, residual))
        for other, moved, size in self.kept:
            along = _dot(other, direction) / size
            direction, change = _less(direction, along, other), _less(change, along, moved)
        if _dot(direction, direction) > least:
            self.kept.append((direction, change, _dot(direction, direction)))


def _dot(a, b) -> float:
    """One product after the other; ``sum`` of Python 3.12 would compensate."""
    total = 0.0
    for x, y in zip(a, b, strict=True):
        total += x * y
    return total


def _less(a, factor, b) -> list[float]:
    return [x - factor * y for x, y in zip(a, b, strict=True)]


@dataclass
class OracleGroup:
    """A group and what it remembers from period to period."""

    plan: Plan
    group: MacroGroup
    signals: np.ndarray
    level: int = 0
    error: float = 0.0
    error_level: int = 0
    repeated: bool = False
    steps: list = field(default_factory=list)
    kept: list = field(default_factory=list)  # (t, h) of every step that was accepted

    def __post_init__(self) -> None:
        g = self.group
        self.members = [self.plan.components[i] for i in g.components]
        self.coupled, self.role, self.needs = {}, {}, {}
        for m in self.members:
            ports = {w.target.port for w in g.wires if w.target.component == m.name} - m.discrete
            self.coupled[m.name] = bool(ports)
            views = {s.port: self.of(s).reshape(s.shape) for s in m.inputs}
            n = sum(s.size for s in m.outputs)
            self.needs[m.name] = direct_outputs(m, views, ports) if ports else {}
            direct = np.any([np.zeros(n, bool), *self.needs[m.name].values()], axis=0)
            jumps = jumping_outputs(m.component)
            held = [s.port in jumps for s in m.outputs for _ in range(s.size)]
            self.role[m.name] = [
                "held" if h else "direct" if d else "counted"
                for h, d in zip(held, direct, strict=True)
            ]
        self.largest = {m.name: np.abs(self.outputs(m)) for m in self.members}
        direct = {m.name: m for m in self.members if "direct" in self.role[m.name]}
        edges = [
            (w.source.component, w.target.component) for w in g.wires
            if w.source.component in direct and self.is_direct(w.source)
        ]  # fmt: skip
        sharp = [(w.source.component, w.target.component) for w in g.wires if self.passes_on(w)]
        self.order = [
            (sequence(names, [e for e in sharp if set(e) <= set(names)]),
             len(names) > 1 or (names[0], names[0]) in sharp)
            for block in strongly_connected(direct, edges)
            for names in strongly_connected(block, sharp)
        ]  # fmt: skip

    def is_direct(self, slot) -> bool:
        return bool(self.direct_places(slot))

    def direct_places(self, slot) -> list[int]:
        m = self.plan.component(slot.component)
        first = slot.start - m.outputs[0].start
        roles = self.role[m.name][first : first + slot.size]
        return [slot.start + i for i, role in enumerate(roles) if role == "direct"]

    def passes_on(self, w) -> bool:
        """An output with direct feed-through meets an input on which one depends."""
        mask = self.needs[w.target.component].get(w.target.port, ())
        roles = self.role[w.target.component]
        needs = any(d and role == "direct" for d, role in zip(mask, roles, strict=False))
        return needs and self.is_direct(w.source)

    def of(self, slot) -> np.ndarray:
        return self.signals[slot.start : slot.start + slot.size]

    def outputs(self, m) -> np.ndarray:
        return np.concatenate([np.zeros(0), *(self.of(s) for s in m.outputs)])

    def put(self, m, values) -> None:
        for s in m.outputs:
            self.of(s)[:], values = values[: s.size], values[s.size :]

    def period(self, tick: int) -> None:
        """Compute the signals at the end of a period; `tick` is the one in which it ends."""
        g, h = self.group, self.plan.h
        whole, length = 2**g.halvings, g.period * h
        start, at = (tick - g.period + 1) * h, 0
        counts = [0.0, 0.0, length]
        while at < whole:
            error = self.macro(start + length * (at / whole), length, at == 0, counts)
            at += 2 ** (g.halvings - self.level)
            self.choose(at, error)
        for slot, value in zip((g.steps, g.rejections, g.size), counts, strict=True):
            self.signals[slot.start] = value

    def macro(self, t: float, length: float, first: bool, counts: list) -> float:
        settings = self.plan.adaptive
        saved = {m.name: copy.deepcopy(m.component.get_state()) for m in self.members}
        before = {m.name: self.outputs(m) for m in self.members}
        inputs = {}
        for w in self.group.wires:
            if not first:
                self.of(w.target)[:] = w.gain * self.of(w.source) + w.offset
            inputs[w.target.name] = self.of(w.target).copy()
        while True:
            h = length / 2**self.level
            error = self.trial(t, h, inputs, saved, settings)
            if self.level == self.group.halvings or error <= 1.0:
                break
            counts[1] += 1.0
            self.shorten(error)
            for m in self.members:
                m.component.set_state(copy.deepcopy(saved[m.name]))
                self.put(m, before[m.name])
            for w in self.group.wires:
                self.of(w.target)[:] = inputs[w.target.name]
        for m in self.members:
            kept = self.largest[m.name] * (1.0 - 0.01)
            self.largest[m.name] = np.maximum(kept, np.abs(self.outputs(m)))
        self.kept.append((t, h))
        counts[0] += 1.0
        counts[2] = min(counts[2], h)
        return error

    def trial(self, t, h, inputs, saved, settings) -> float:
        before = {m.name: self.outputs(m) for m in self.members}
        for m in self.members:
            self.step(m, t, h)
        self.finish(t + h, h, before, None)
        first = {m.name: self.outputs(m) for m in self.members}
        sweep = 0
        while True:
            sweep += 1
            last, guess = {m.name: self.outputs(m) for m in self.members}, self.signals.copy()
            for w in self.group.wires:
                end = w.gain * self.of(w.source) + w.offset
                start = inputs[w.target.name]
                self.of(w.target)[:] = start if self.held(w) else 0.5 * (start + end)
            for m in self.members:
                if self.coupled[m.name]:
                    m.component.set_state(copy.deepcopy(saved[m.name]))
                    self.step(m, t, h)
            self.finish(t + h, h, before, guess)
            error = self.distance(first, settings)
            if settings.iterations == 1:
                return error
            change = self.distance(last, settings)
            if 10.0 * change <= 1.0:
                return error
            if sweep >= settings.iterations:
                return max(error, change)

    def held(self, w) -> bool:
        return w.target.port in self.plan.component(w.target.component).discrete

    def finish(self, t, h, before, guess) -> None:
        """Outputs with direct feed-through, for the inputs at t: the end of a step of length h."""
        for names, loop in self.order:
            members = [self.plan.component(name) for name in names]
            if loop:
                self.finish_loop(members, t, h, guess)
                continue
            (m,) = members
            there = self.outputs(m)
            y = self.shortly(m, t, h)
            self.put(m, np.where(self.mask(m), y - (y - before[m.name]) / 1025, there))

    def finish_loop(self, members, t, h, guess) -> None:
        """Outputs of components that wait for each other: passes over them until they agree."""
        names = [m.name for m in members]
        places, fed = self.loop_outputs(names)
        largest = np.zeros(len(self.signals))
        for m in members:
            values = self.largest[m.name]
            for s in m.outputs:
                largest[s.start : s.start + s.size], values = values[: s.size], values[s.size :]
        drift = {m.name: self.shortly(m, t, h, carry=False) - self.outputs(m) for m in members}
        there = {m.name: self.outputs(m) for m in members}
        taken = [float((self.signals if guess is None else guess)[i]) for i in places]
        a = self.plan.adaptive
        scale = [
            a.absolute + a.tolerance * max(abs(y), float(largest[i]))
            for y, i in zip(taken, places, strict=True)
        ]
        secants = Secants(fed, scale)
        for number in range(100):
            self.signals[list(places)] = taken
            for m in members:
                y = self.shortly(m, t, h)
                self.put(m, np.where(self.mask(m), y - drift[m.name], there[m.name]))
            taken, left = secants.next(taken, [float(self.signals[i]) for i in places])
            if number > 0 and 10.0 * left <= 1.0:
                return
        raise AssertionError("the loop has no solution")

    def loop_outputs(self, names) -> tuple[list[int], int]:
        """Signals with direct feed-through; how many of them, the first, are fed back."""
        back = set()
        for w in self.group.wires:
            a, b = w.source.component, w.target.component
            if {a, b} <= set(names) and self.passes_on(w) and names.index(a) >= names.index(b):
                back |= set(self.direct_places(w.source))
        slots = [s for name in names for s in self.plan.component(name).outputs]
        own = {i for s in slots for i in self.direct_places(s)}
        return [*sorted(back), *sorted(own - back)], len(back)

    def mask(self, m) -> list[bool]:
        return [r == "direct" for r in self.role[m.name]]

    def shortly(self, m, t, h, carry: bool = True) -> np.ndarray:
        """Outputs after a short step, which is undone; `carry`: with the inputs at its start."""
        inputs = [(s, self.of(s).copy()) for s in m.inputs]
        for w in self.group.wires:
            if carry and w.target.component == m.name and not self.held(w):
                self.of(w.target)[:] = w.gain * self.of(w.source) + w.offset
        state, there = copy.deepcopy(m.component.get_state()), self.outputs(m)
        self.step(m, t, h / 1024)
        m.component.set_state(state)
        for slot, values in inputs:
            self.of(slot)[:] = values
        found = self.outputs(m)
        self.put(m, there)
        return found

    def step(self, m, t, h) -> None:
        u = {s.port: self.of(s).reshape(s.shape).copy() for s in m.inputs}
        y = m.component.step(t, h, u)
        for s in m.outputs:
            self.of(s)[:] = np.reshape(y[s.port], -1)

    def distance(self, others, settings) -> float:
        most = 0.0
        for m in self.members:
            y = self.outputs(m)
            size = np.maximum(np.abs(y), self.largest[m.name])
            errors = np.abs(y - others[m.name]) / (settings.absolute + settings.tolerance * size)
            for error, role in zip(errors, self.role[m.name], strict=True):
                if role == "counted":
                    most = max(most, float(error))
        return most

    def choose(self, at: int, error: float) -> None:
        before = self.error * 4.0 ** (self.error_level - self.level)
        expected = error
        if before > 0.0 and error > before:
            expected = error * (error / before if error < 2.0 * before else 2.0)
        self.error, self.error_level = error, self.level
        halvings = self.group.halvings
        if expected > 1.0 and self.level < halvings:
            self.level += 1
        elif (4.0 * expected <= 0.8 and self.level > 0 and not self.repeated
              and at % 2 ** (halvings - self.level + 1) == 0):  # fmt: skip
            self.level -= 1
        self.repeated = False

    def shorten(self, error: float) -> None:
        self.level, error = self.level + 1, error * 0.25
        while error > 0.8 and self.level < self.group.halvings:
            self.level, error = self.level + 1, error * 0.25
        self.repeated = True
