"""Macro steps of the oracle: one group over one period, in plain Python (``cosim/c/macro.h``)."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

import numpy as np

from cosim.engine.feedthrough import direct_outputs
from cosim.fmi.components import jumping_outputs
from cosim.schedule.macro import MacroGroup
from cosim.schedule.order import strongly_connected
from cosim.schedule.plan import Plan


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
        self.coupled, self.role = {}, {}
        for m in self.members:
            ports = {w.target.port for w in g.wires if w.target.component == m.name} - m.discrete
            self.coupled[m.name] = bool(ports)
            views = {s.port: self.of(s).reshape(s.shape) for s in m.inputs}
            n = sum(s.size for s in m.outputs)
            direct = direct_outputs(m, views, ports) if ports else np.zeros(n, bool)
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
        self.order = [direct[n] for block in strongly_connected(direct, edges) for n in block]

    def is_direct(self, slot) -> bool:
        m = self.plan.component(slot.component)
        first = slot.start - m.outputs[0].start
        return "direct" in self.role[m.name][first : first + slot.size]

    def of(self, slot) -> np.ndarray:
        return self.signals[slot.start : slot.start + slot.size]

    def outputs(self, m) -> np.ndarray:
        return np.concatenate([np.zeros(0), *(self.of(s) for s in m.outputs)])

    def put(self, m, values) -> None:
        for s in m.outputs:
            self.of(s)[:], values = values[: s.size], values[s.size :]

    def period(self, tick: int) -> None:
        """From the tick in which the period began; `tick` is the one in which it ends."""
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
        self.finish(t + h, h, before)
        first = {m.name: self.outputs(m) for m in self.members}
        sweep = 0
        while True:
            sweep += 1
            last = {m.name: self.outputs(m) for m in self.members}
            for w in self.group.wires:
                end = w.gain * self.of(w.source) + w.offset
                start = inputs[w.target.name]
                self.of(w.target)[:] = start if self.held(w) else 0.5 * (start + end)
            for m in self.members:
                if self.coupled[m.name]:
                    m.component.set_state(copy.deepcopy(saved[m.name]))
                    self.step(m, t, h)
            self.finish(t + h, h, before)
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

    def finish(self, t, h, before) -> None:
        """Outputs with direct feed-through, for the inputs at t: the end of a step of length h."""
        for m in self.order:
            inputs = [(s, self.of(s).copy()) for s in m.inputs]
            for w in self.group.wires:
                if w.target.component == m.name and not self.held(w):
                    self.of(w.target)[:] = w.gain * self.of(w.source) + w.offset
            state, there = copy.deepcopy(m.component.get_state()), self.outputs(m)
            self.step(m, t, h / 1024)
            m.component.set_state(state)
            for slot, values in inputs:
                self.of(slot)[:] = values
            y = self.outputs(m)
            direct = [r == "direct" for r in self.role[m.name]]
            self.put(m, np.where(direct, y - (y - before[m.name]) / 1025, there))

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
