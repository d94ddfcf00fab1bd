"""The engine of this project as a session, with and without recording, and the whole `simulate`."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import Case, Choice
from cosim.base.clock import stopwatch
from cosim.base.interrupts import stop_on_signal
from cosim.engine.engine import Engine
from cosim.engine.simulate import CHUNK_TICKS, CHUNK_VALUES, simulate
from cosim.record import Run
from cosim.schedule.plan import Plan

Rows = NDArray[np.float64]


@final
class Ours:
    """A session of the engine on `plan`, in chunks as in a run.

    `length`: ticks that fit into `rows`, or 0 to record nothing.
    """

    def __init__(self, plan: Plan, length: int = 0) -> None:
        self._plan = plan
        self._engine = Engine(plan)
        self._engine.initialize()
        self.rows: Rows = np.zeros((length, plan.n_signals))
        self._chunk = max(64, min(CHUNK_TICKS, CHUNK_VALUES // plan.n_signals))

    def run(self, ticks: int) -> float:
        """Go on for `ticks` ticks, recording from the first row; returns s."""
        with stop_on_signal(self._engine.stop):  # once, as in a run
            watch = stopwatch()
            for start in range(0, ticks, self._chunk):
                end = min(start + self._chunk, ticks)
                rows = self.rows[start:end] if len(self.rows) else None
                self._engine.run(end - start, rows)
            return watch()

    def outputs(self) -> bytes:
        """The outputs of all components as they are."""
        return b"".join(
            self._engine.signals[s.start : s.start + s.size].tobytes()
            for step in self._plan.components
            for s in step.outputs
        )

    def recorded(self, n: int) -> bytes:
        """The first `n` rows since the last `run`; empty where nothing is recorded."""
        return self.rows[:n].tobytes()

    def close(self) -> None:
        """Free the FMUs."""
        self._engine.close()


@final
class Recorded:
    """A session that runs the whole case into a run folder, each time from the start.

    What counts is what ``cosim run`` calls wall time: engine, links, and Parquet until the file
    is closed; not the start of the FMUs.
    """

    def __init__(self, case: Case, choice: Choice) -> None:
        self._case, self._choice = case, choice
        self._folder = tempfile.TemporaryDirectory(prefix="recorded-")
        self._run, self._plan = Path(self._folder.name, "run"), case.plan(choice)

    def run(self, ticks: int) -> float:
        """Run `ticks` ticks; returns s."""
        scenario = self._case.scenario(self._choice, ticks)
        return simulate(scenario, self._run, force=True).wall

    def outputs(self) -> bytes:
        """The outputs of all components in the last row of the file."""
        run = Run.open(self._run)
        names = [slot.name for step in self._plan.components for slot in step.outputs]
        return b"".join(run.array(name)[-1].tobytes() for name in names)

    def recorded(self, n: int) -> bytes:
        """In a file, and outputs only."""
        return b""

    def close(self) -> None:
        """Delete the folder."""
        self._folder.cleanup()
