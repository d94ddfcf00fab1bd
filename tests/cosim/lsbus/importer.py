"""A small importer of FMUs with CAN terminals, by the rules of FMI 3.0, that runs them with FMPy.

It shares no code with the importer of this project: a check of FMUs, not of that importer.
"""

from __future__ import annotations

import ctypes as c
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave

PS = 1e-12
NEVER = 1 << 62
CHANGED = 2


@dataclass
class End:
    """A terminal of an FMU: the first of its four value references, and its Tx clock."""

    fmu: Imported
    first: int
    kind: str = "countdown"
    due: int = NEVER
    period: int = 0
    ticked: bool = False
    sent: list[bytes] = field(default_factory=list)

    def ask(self, ticked: bool, at: int) -> None:
        """The time of the Tx clock's next tick."""
        if self.kind == "countdown" or (self.kind == "changing" and ticked):
            value, qualifier = self.interval()
            if qualifier == CHANGED:
                self.due = at + round(value / PS)

    def interval(self) -> tuple[float, int]:
        """``fmi3GetIntervalDecimal``."""
        value, qualifier = (c.c_double * 1)(), (c.c_int * 1)()
        self.fmu.slave.getIntervalDecimal((c.c_uint32 * 1)(self.first), value, qualifier)
        return value[0], qualifier[0]

    def start(self) -> None:
        """Ask for interval and shift, in Initialization Mode."""
        if self.kind == "changing":
            self.due = round(self.interval()[0] / PS)
        elif self.kind in ("fixed", "tunable"):
            shift = (c.c_double * 1)()
            self.fmu.slave.getShiftDecimal((c.c_uint32 * 1)(self.first), shift)
            self.period, self.due = round(self.interval()[0] / PS), round(shift[0] / PS)

    def take(self, at: int) -> bytes:
        """Its operations, if its Tx clock ticks at `at` ps."""
        slave = self.fmu.slave
        self.ticked = False
        if self.kind == "triggered":
            if not slave.getClock([self.first])[0]:
                return b""
        elif self.due > at:
            return b""
        else:
            slave.setClock([self.first], [True])
            self.due = self.due + self.period if self.period else NEVER
        self.ticked = True
        return bytes(slave.getBinary([self.first + 2])[0])

    def give(self, operations: bytes) -> None:
        """Operations for the FMU."""
        self.fmu.slave.setClock([self.first + 1], [True])
        self.fmu.slave.setBinary([self.first + 3], [operations])


class Imported:
    """An FMU in FMPy."""

    def __init__(self, path: Path, values: Mapping[int, float], notify: int | None = None) -> None:
        self.folder = extract(str(path))
        description = read_model_description(self.folder, validate=False)
        self.slave: Any = FMU3Slave(
            guid=description.guid,
            unzipDirectory=self.folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.slave.instantiate(eventModeUsed=True)
        self.slave.enterInitializationMode()
        if values:
            self.slave.setFloat64(list(values), list(values.values()))
        if notify is not None:
            self.slave.setBoolean([notify], [True])

    def free(self) -> None:
        """Free the instance and its files."""
        self.slave.terminate()
        self.slave.freeInstance()
        shutil.rmtree(self.folder, ignore_errors=True)


def run(
    fmus: Sequence[Imported], pairs: Sequence[tuple[End, End]], until: int, grid: int
) -> list[tuple[int, int, bool, bytes]]:
    """Run to `until` ps; (time in ps, pair, whether its first end sent it, operations)."""
    ends = [(i, side, end) for i, pair in enumerate(pairs) for side, end in enumerate(pair)]
    for _, _, end in ends:
        end.start()
    for fmu in fmus:
        fmu.slave.exitInitializationMode()
    log: list[tuple[int, int, bool, bytes]] = []
    now = 0
    while True:
        _events(fmus, pairs, ends, now, log)
        if now >= until:
            break
        stop = min(until, (now // grid + 1) * grid, *(end.due for _, _, end in ends))
        for fmu in fmus:
            fmu.slave.enterStepMode()
            fmu.slave.doStep(now * PS, stop * PS - now * PS)
            fmu.slave.enterEventMode()
        now = stop
    for fmu in fmus:
        fmu.slave.enterStepMode()
        fmu.free()
    return log


def _events(
    fmus: Sequence[Imported],
    pairs: Sequence[tuple[End, End]],
    ends: Sequence[tuple[int, int, End]],
    now: int,
    log: list[tuple[int, int, bool, bytes]],
) -> None:
    again = True
    while again:
        taken = [(i, side, end.take(now)) for i, side, end in ends]
        for i, side, operations in taken:
            if operations:
                log.append((now, i, side == 0, operations))
                pairs[i][1 - side].give(operations)
        again = any([fmu.slave.updateDiscreteStates()[0] for fmu in fmus])
        for _, _, end in ends:
            end.ask(end.ticked, now)
        again = again or any(end.due <= now for _, _, end in ends)
