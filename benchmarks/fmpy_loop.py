"""FMPy's slave API: the loop is the user's, in Python, one call an FMU and function."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

from benchmarks.peers import Unit, imported, units
from cosim.base.clock import stopwatch
from cosim.engine.engine import Engine
from cosim.native.enums import Code
from cosim.schedule.operations import Operation
from cosim.schedule.plan import Plan

Getter = Callable[[], list[float]]
Setter = Callable[[list[float]], None]


@final
class Slaves:
    """The FMUs of a plan in FMPy's hands, initialised; `put` and `get` by component."""

    def __init__(self, all_units: list[Unit]) -> None:
        fmpy = imported("fmpy")
        self.three = all_units[0].fmi == "3.0"
        self._folder = tempfile.TemporaryDirectory(prefix="fmpy-")
        make = imported("fmpy.fmi3" if self.three else "fmpy.fmi2")
        slave = make.FMU3Slave if self.three else make.FMU2Slave
        found = {}
        for path in {unit.path for unit in all_units}:
            folder = fmpy.extract(path, str(Path(self._folder.name, path.stem)))
            found[path] = folder, fmpy.read_model_description(path, validate=False)
        self.fmus: list[Any] = []
        for unit in all_units:
            folder, description = found[unit.path]
            self.fmus.append(
                slave(
                    guid=description.guid,
                    unzipDirectory=folder,
                    modelIdentifier=description.coSimulation.modelIdentifier,
                    instanceName=unit.name,
                )
            )
            self._initialize(self.fmus[-1], unit)
        self.get = [self._getter(f, u) for f, u in zip(self.fmus, all_units, strict=True)]
        self.put = [self._setter(f, u) for f, u in zip(self.fmus, all_units, strict=True)]

    def _initialize(self, fmu: Any, unit: Unit) -> None:
        fmu.instantiate()
        for v in unit.start:
            if v.real:
                (fmu.setFloat64 if self.three else fmu.setReal)([v.reference], v.values)
            else:
                values = [int(x) for x in v.values]
                (fmu.setInt32 if self.three else fmu.setInteger)([v.reference], values)
        if self.three:
            fmu.enterInitializationMode(startTime=0.0)
        else:
            fmu.setupExperiment(startTime=0.0)
            fmu.enterInitializationMode()
        fmu.exitInitializationMode()

    def _getter(self, fmu: Any, unit: Unit) -> Getter:
        references, n = [v.reference for v in unit.outputs], sum(v.size for v in unit.outputs)
        if self.three:
            return lambda: fmu.getFloat64(references, n)
        return lambda: fmu.getReal(references)

    def _setter(self, fmu: Any, unit: Unit) -> Setter:
        references = [v.reference for v in unit.inputs]
        put = fmu.setFloat64 if self.three else fmu.setReal
        return lambda values: put(references, values)

    def close(self) -> None:
        """Free the FMUs."""
        for fmu in self.fmus:
            fmu.terminate()
            fmu.freeInstance()
        self._folder.cleanup()


@final
class Ring:
    """FMUs that feed each other: the shortest loop. `recorded`: all outputs in a list of rows."""

    def __init__(self, plan: Plan, recorded: bool) -> None:
        self._units, self._h, self._k = units(plan), plan.h, 0
        self._slaves = Slaves(self._units)
        self._recorded, self._rows = recorded, list[list[list[float]]]()
        self._y = [get() for get in self._slaves.get]

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""
        y, h, get = self._y, self._h, self._slaves.get
        feeds = [
            (put, unit.source)
            for put, unit in zip(self._slaves.put, self._units, strict=True)
            if unit.source is not None
        ]
        steps = [fmu.doStep for fmu in self._slaves.fmus]
        self._rows.clear()
        watch = stopwatch()
        for k in range(self._k, self._k + ticks):
            if self._recorded:
                self._rows.append(y)
            for put, source in feeds:
                put(y[source])
            for step in steps:
                step(k * h, h)
            y = [read() for read in get]
        seconds = watch()
        self._k, self._y = self._k + ticks, y
        return seconds

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        return b"".join(struct.pack(f"={len(y)}d", *y) for y in self._y)

    def recorded(self, n: int) -> bytes:
        """In a form of its own."""
        return b""

    def close(self) -> None:
        """Free the FMUs."""
        self._slaves.close()


@final
class Planned:
    """A plan with rates and delays, walked in Python; links as lists of what was sent."""

    def __init__(self, plan: Plan, recorded: bool) -> None:
        with Engine(plan) as engine:
            engine.initialize()
            self._s: list[float] = engine.signals.tolist()
        self._plan, self._recorded, self._k = plan, recorded, 0
        self._slaves = Slaves(units(plan, links=True))
        self._rows: list[list[float]] = []
        self._sent = [  # what was there before, then all that was sent
            [self._s[x.target.start : x.target.start + x.target.size]] for x in plan.links
        ]
        self._held = [self._table(i) for i in range(len(plan.links))]

    def _table(self, index: int) -> list[int]:
        link = self._plan.links[index]
        hits = -(-self._plan.ticks // self._plan.component(link.target.component).period)
        return link.table.stream(hits).rows(hits).tolist()  # type: ignore[no-any-return]

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""
        self._rows.clear()
        watch = stopwatch()
        for k in range(self._k, self._k + ticks):
            for op in self._plan.operations:
                if k % op.period == op.first:
                    self._do(op, k)
        seconds = watch()
        self._k += ticks
        return seconds

    def _do(self, op: Operation, k: int) -> None:
        s = self._s
        if op.code is Code.STEP:
            c, h = self._plan.components[op.index], self._plan.h
            a, b = c.inputs[0].start, c.outputs[0].start
            self._slaves.put[op.index](s[a : c.inputs[-1].start + c.inputs[-1].size])
            self._slaves.fmus[op.index].doStep((k - op.first) * h, op.period * h)
            s[b : c.outputs[-1].start + c.outputs[-1].size] = self._slaves.get[op.index]()
        elif op.code is Code.COPY:
            s[op.target : op.target + op.count] = s[op.source : op.source + op.count]
        elif op.code is Code.PUSH:
            self._sent[op.index].append(s[op.source : op.source + op.count])
        elif op.code is Code.PULL:
            held = self._held[op.index][k // op.period]
            s[op.target : op.target + op.count] = self._sent[op.index][1 + held]
        elif op.code is Code.RECORD and self._recorded:
            self._rows.append(s[:])

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        slots = [slot for step in self._plan.components for slot in step.outputs]
        return b"".join(
            struct.pack(f"={x.size}d", *self._s[x.start : x.start + x.size]) for x in slots
        )

    def recorded(self, n: int) -> bytes:
        """In a form of its own."""
        return b""

    def close(self) -> None:
        """Free the FMUs."""
        self._slaves.close()
