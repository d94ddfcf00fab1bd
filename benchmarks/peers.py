"""Other masters on the same FMUs: libcosim and Ecos, each as its own guide uses it.

Both exchange outputs and inputs as `algorithm = "jacobi"` does here, so that results can be
compared to the bit. A peer that is not installed, or cannot take a case, raises :class:`Absent`.
"""

from __future__ import annotations

import importlib
import os
import struct
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, final

from cosim.base.clock import stopwatch
from cosim.fmi import FmuComponent
from cosim.fmi.file.ports import REAL
from cosim.schedule.parts import Step
from cosim.schedule.plan import Plan


class Absent(Exception):
    """A peer that cannot take part, and why."""


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of an FMU: `size` is 1 in FMI 2.0; `values`: start values, if they are set."""

    name: str
    reference: int
    size: int
    real: bool
    values: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Unit:
    """An FMU, the variables that count, and the index of the unit that feeds it."""

    name: str
    path: Path
    fmi: str
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    start: tuple[Variable, ...]
    source: int | None


def units(plan: Plan, *, links: bool = False) -> list[Unit]:
    """A plan in the terms of other masters. Raises Absent for links, unless `links`."""
    if plan.links and not links:
        raise Absent("has no latency on a connection")
    names = [c.name for c in plan.components]
    feeds = {w.target.component: names.index(w.source.component) for w in plan.wires}
    return [_unit(step, feeds.get(step.name)) for step in plan.components]


def _unit(step: Step, source: int | None) -> Unit:
    fmu = step.component
    assert isinstance(fmu, FmuComponent)

    def variables(names: Iterable[str]) -> tuple[Variable, ...]:
        return tuple(_variable(fmu, v, step) for name in names for v in fmu.groups[name].variables)

    inputs, outputs = ([p.name for p in ports] for ports in (fmu.inputs, fmu.outputs))
    path, fmi = fmu.archive.path, fmu.description.fmi
    start = variables(step.values)
    return Unit(step.name, path, fmi, variables(inputs), variables(outputs), start, source)


def _variable(fmu: FmuComponent, variable: Any, step: Step) -> Variable:
    name = variable.name.partition("[")[0]
    values = step.values.get(name, ())
    if len(fmu.groups[name].variables) > 1:
        at = fmu.groups[name].variables.index(variable)
        values = values[at : at + 1]
    real = variable.type in REAL
    return Variable(variable.name, variable.reference, variable.size, real, values)


def imported(name: str) -> ModuleType:
    """The module of a peer. Raises Absent where it cannot be imported."""
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        raise Absent(f"does not import: {str(error).splitlines()[0]}") from error


@contextmanager
def silence() -> Iterator[None]:
    """Send what libraries write to the terminal by themselves to nowhere."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        for number, old in enumerate(kept, 1):
            os.dup2(old, number)
            os.close(old)
        os.close(nowhere)


@final
class Libcosim:
    """libcosim through libcosimpy: fixed step, connections variable by variable.

    `recorded`: every output in a time series in memory.
    """

    def __init__(self, plan: Plan, recorded: bool) -> None:
        self._units = units(plan)
        if self._units[0].fmi != "2.0":
            raise Absent("reads FMI 1.0 and 2.0 only")
        execution = imported("libcosimpy.CosimExecution").CosimExecution
        observers = imported("libcosimpy.CosimObserver").CosimObserver
        slaves = imported("libcosimpy.CosimSlave")
        log = imported("libcosimpy.CosimLogging")
        log.log_output_level(log.CosimLogLevel.FATAL)
        self._run = execution.from_step_size(round(plan.h * 1e9))  # ns
        self._slaves = [slaves.CosimLocalSlave(str(u.path), u.name) for u in self._units]
        self._index = [self._run.add_local_slave(slave) for slave in self._slaves]
        self._start()
        self._last = observers.create_last_value()
        self._run.add_observer(self._last)
        if recorded:
            real = imported("libcosimpy.CosimEnums").CosimVariableType.REAL
            self._series = observers.create_time_series()
            self._run.add_observer(self._series)
            for index, unit in zip(self._index, self._units, strict=True):
                for v in unit.outputs:
                    self._series.start_time_series(index, v.reference, real)

    def _start(self) -> None:
        for index, unit in zip(self._index, self._units, strict=True):
            for v in unit.start:
                self._run.real_initial_value(index, v.reference, v.values[0])
            if unit.source is None:
                continue
            origin = self._units[unit.source]
            for a, b in zip(origin.outputs, unit.inputs, strict=True):
                self._run.connect_real_variables(
                    self._index[unit.source], a.reference, index, b.reference
                )

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""
        watch = stopwatch()
        done = self._run.step(ticks)
        seconds = watch()
        if not done:
            raise Absent("stopped with an error")
        return seconds

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        parts = []
        for index, unit in zip(self._index, self._units, strict=True):
            values = self._last.last_real_values(index, [v.reference for v in unit.outputs])
            parts.append(struct.pack(f"={len(values)}d", *values))
        return b"".join(parts)

    def recorded(self, n: int) -> bytes:
        """In a form of its own."""
        return b""

    def close(self) -> None:
        """Freed with the object."""


@final
class Ecos:
    """Ecos through ecospy: fixed step, connections variable by variable.

    `recorded`: every output into a CSV file, its only place for results.
    """

    def __init__(self, plan: Plan, recorded: bool) -> None:
        self._units = units(plan)
        if any(v.size > 1 for u in self._units for v in (*u.inputs, *u.outputs, *u.start)):
            raise Absent("connects no arrays")
        ecos = imported("ecospy")
        ecos.EcosLib.set_log_level("err")
        self._structure = ecos.EcosSimulationStructure()
        for unit in self._units:
            self._structure.add_model(unit.name, str(unit.path))
        for unit in self._units:
            self._connect(unit)
        start = {f"{u.name}::{v.name}": v.values[0] for u in self._units for v in u.start}
        self._structure.add_parameter_set("start", start)
        self._run = ecos.EcosSimulation(plan.h, structure=self._structure)
        self._folder = tempfile.TemporaryDirectory(prefix="ecos-")
        self._names = [f"{u.name}::{v.name}" for u in self._units for v in u.outputs]
        if recorded:
            csv = str(Path(self._folder.name, "results.csv"))
            self._run.add_csv_writer(csv, identifiers=self._names)
        if not self._run.init(0, "start"):
            raise Absent("does not initialise")

    def _connect(self, unit: Unit) -> None:
        if unit.source is not None:
            origin = self._units[unit.source]
            for a, b in zip(origin.outputs, unit.inputs, strict=True):
                source, sink = f"{origin.name}::{a.name}", f"{unit.name}::{b.name}"
                self._structure.make_real_connection(source, sink)

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks; returns s."""
        watch = stopwatch()
        self._run.step(ticks)
        return watch()

    def outputs(self) -> bytes:
        """The outputs of all FMUs as they are."""
        values = [self._run.get_real(name) for name in self._names]
        return struct.pack(f"={len(values)}d", *values)

    def recorded(self, n: int) -> bytes:
        """In a form of its own."""
        return b""

    def close(self) -> None:
        """Free everything."""
        self._run.terminate()
        self._run.free()
        self._structure.free()
        self._folder.cleanup()
