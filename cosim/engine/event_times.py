"""Times at which FMUs are in Event Mode, between the ticks of a run: a table of its folder."""

from __future__ import annotations

import csv
import ctypes as c
from pathlib import Path

import numpy as np

from cosim.base.errors import RunError, ScenarioError
from cosim.engine.engine import Engine
from cosim.fmi.components import fmu_of
from cosim.native import structs
from cosim.record.folder import EVENTS, reason
from cosim.schedule.plan import Plan

#: Events of an FMU that are kept; more are counted.
MOST = 1 << 20


def check_events(plan: Plan, place: str) -> None:
    """Raise ScenarioError at `place` where the times of events cannot be told."""
    if plan.algorithm == "adaptive":
        raise ScenarioError(
            "found true with adaptive steps, whose events may be taken back; expected false", place
        )
    for step in plan.components:
        fmu = fmu_of(step.component)
        if fmu is not None and fmu.options.isolate:
            raise ScenarioError(
                f"found true, and {step.name} is isolated: its process does not tell; expected "
                "isolate = false",
                place,
            )


class EventTimes:
    """The times (s) of the events of an engine that is initialised: those of its run, not of its
    start.
    """

    def __init__(self, engine: Engine) -> None:
        self._found = {}
        for step, unit in zip(engine.plan.components, engine.bound.units, strict=True):
            if not unit.typed:
                continue
            times = np.empty(MOST)  # takes no memory as long as nothing is written
            struct = structs.EventTimesStruct(times.ctypes.data, 0, MOST)
            structs.TypedStruct.from_address(unit.typed).happened = c.addressof(struct)
            self._found[step.name] = struct, times

    def counts(self) -> dict[str, int]:
        """The number of events of each FMU that can have any."""
        return {name: int(struct.count) for name, (struct, _) in self._found.items()}

    def write(self, folder: Path) -> None:
        """Write ``events.csv``: time (s) and component, in the order of time. Raises RunError."""
        rows = [
            (float(t), name)
            for name, (struct, times) in self._found.items()
            for t in times[: min(struct.count, MOST)]
        ]
        try:
            with (folder / EVENTS).open("w", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerows([("t", "component"), *sorted(rows)])
        except OSError as error:
            raise RunError(f"cannot write {folder / EVENTS}: {reason(error)}") from error
