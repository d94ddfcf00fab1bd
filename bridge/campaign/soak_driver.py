"""A soak: runs side by side until their time adds up, each once, whatever ends the process."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from math import ceil
from pathlib import Path
from typing import Any

from bridge.campaign.soak import RUNS, SoakSetup, run_soak
from bridge.relay import namespaces
from bridge.results.verdict import Word
from cosim.base.errors import ScenarioError
from cosim.base.interrupts import stop_on_signal
from cosim.base.processes import processes, spread
from cosim.engine.simulate import versions
from cosim.sweeps import store as stores
from cosim.sweeps.execute import PlannedRuns
from cosim.sweeps.run_point import StudyRow
from cosim.sweeps.store import Store

#: Of the measures of a run, besides numbers of faults.
UNITS: Mapping[str, str] = {"s": "s", "torque": "N.m", "late_p99_ms": "ms", "together": "rad"}
TABLE, SUMMARY = "soak.parquet", "summary.md"
Record = dict[str, Any]


def count(hours: float, seconds: float) -> int:
    """Runs of so many seconds that make so many hours."""
    return max(1, ceil(hours * 3600.0 / seconds))


@dataclass(frozen=True, slots=True)
class RunsObserver:
    """Observer of many runs: `begun` once, `done` with every row, `stopping` after Ctrl-C."""

    begun: Callable[[PlannedRuns], None] = lambda begun: None
    done: Callable[[StudyRow], None] = lambda row: None
    stopping: Callable[[], None] = lambda: None


UNOBSERVED = RunsObserver()


def soak(
    job: SoakSetup,
    runs: int,
    parallel: int,
    retry: bool = False,
    observer: RunsObserver = UNOBSERVED,
) -> list[Record]:
    """All runs of a soak; see :func:`drive`."""
    return drive(
        job.folder, job.soak.spec.title, _facts(job), partial(run_soak, job), runs, parallel,
        retry=retry, observer=observer,
    )  # fmt: skip


def drive(
    folder: Path,
    title: str,
    facts: Mapping[str, Any],
    perform: Callable[[int], StudyRow],
    runs: int,
    parallel: int,
    *,
    retry: bool = False,
    observer: RunsObserver = UNOBSERVED,
) -> list[Record]:
    """Execute the runs that are missing in the folder; return the rows of all runs in their order.

    `perform`: executes and evaluates run k in a separate process; `facts`: distinguish this folder
    from others. `retry`: also repeat runs that did not pass.

    After a first Ctrl-C, KeyboardInterrupt is raised when the active runs have ended; after a
    second one, immediately. Raises ScenarioError if the folder was created with other facts, never
    for a run that fails.
    """
    with stores.lock_folder(folder):
        _claim(folder, title, facts)
        namespaces.sweep()
        with Store(folder, UNITS) as store:
            names = {f"{k:05d}": k for k in range(runs)}
            again = store.failed & set(names) if retry else set[str]()
            todo = [k for name, k in names.items() if name not in store.done - again]
            there = len(store.done & set(names))
            observer.begun(PlannedRuns(runs, runs, there, len(todo), False, 0, len(again)))
            try:
                _run(perform, todo, parallel, store, observer)
            finally:
                with stop_on_signal(lambda: None):
                    namespaces.sweep()  # of workers that were killed
        found = stores.rows(folder)
        records = [found[name] for name in sorted(found)]
        stores.write_table(folder / TABLE, records, UNITS)
    return records


def _run(
    perform: Callable[[int], StudyRow],
    todo: Sequence[int],
    parallel: int,
    store: Store,
    observer: RunsObserver,
) -> None:
    pressed: list[bool] = []

    def stop() -> None:
        pressed.append(True)
        observer.stopping()

    opened = partial(processes, parallel)
    with stop_on_signal(stop):
        for k, result in spread(opened, perform, todo, lambda: bool(pressed)):
            if isinstance(result, str):
                result = StudyRow(
                    f"{k:05d}", {"faults": "", "verdict": str(Word.ERROR)}, (), False, result
                )
            store.append(result)
            observer.done(result)


def _facts(job: SoakSetup) -> dict[str, Any]:
    """Facts that distinguish this folder from that of another soak test."""
    files = (job.scenario, job.deployment, job.soak.path)
    return {
        "scenario": str(job.scenario),
        "deployment": str(job.deployment),
        "settings": list(job.changes),
        "seed": job.seed,
        "network": job.network,
        "fingerprint": sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest(),
    }


def _claim(folder: Path, title: str, facts: Mapping[str, Any]) -> None:
    """Take the folder, which is empty or has runs of the same kind. Raises ScenarioError."""
    state = stores.read_state(folder)
    present = sorted(p.name for p in folder.iterdir() if p.name != stores.LOCK)
    if present and not state:
        raise ScenarioError(
            f"the folder holds {present[0]} but no soak test; expected an empty folder", str(folder)
        )
    for key, value in facts.items():
        if state and state.get(key) != value:
            raise ScenarioError(
                f"was started with another {key}, {state.get(key)}; expected {value}, or another "
                "folder",
                str(folder),
            )
    if not state:
        shutil.rmtree(folder / RUNS, ignore_errors=True)
    stores.write_state(folder, {"title": title, **facts, "versions": versions()})
