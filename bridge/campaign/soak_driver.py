"""A soak: runs side by side until their time adds up, each once, whatever ends the process."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from math import ceil
from pathlib import Path
from typing import Any, TypeVar

from bridge.campaign.soak import RUNS, SoakSetup, run_soak
from bridge.relay import namespaces
from bridge.results.verdict import Word
from cosim.base.interrupts import stop_on_signal
from cosim.base.processes import processes
from cosim.engine.simulate import versions
from cosim.record import held_folder
from cosim.study import store as stores
from cosim.study.run_point import StudyRow
from cosim.study.runner import UNOBSERVED, Observer, claim, run_named
from cosim.study.store import Store

#: Of the measures of a run, besides numbers of faults.
UNITS: Mapping[str, str] = {"s": "s", "torque": "N.m", "late_p99_ms": "ms", "together": "rad"}
TABLE, SUMMARY = "soak.parquet", "summary.md"
Record = dict[str, Any]
C = TypeVar("C")


def count(hours: float, seconds: float) -> int:
    """Runs of so many seconds that make so many hours."""
    return max(1, ceil(hours * 3600.0 / seconds))


@dataclass(frozen=True, slots=True)
class RunsFolder:
    """The folder of many runs: what it is for, in messages, and facts that tell it from others."""

    path: Path
    what: str
    facts: Mapping[str, Any]


def soak(
    job: SoakSetup,
    runs: int,
    parallel: int,
    retry: bool = False,
    observer: Observer = UNOBSERVED,
) -> list[Record]:
    """All runs of a soak; see :func:`drive`."""
    place = RunsFolder(job.folder, "soak test", _facts(job))
    return drive(
        place, partial(run_soak, job), numbered(runs), parallel, retry=retry, observer=observer
    )


def numbered(runs: int) -> dict[str, int]:
    """The numbers of so many runs, by the name of each."""
    return {f"{k:05d}": k for k in range(runs)}


def drive(
    place: RunsFolder,
    perform: Callable[[C], StudyRow],
    cases: Mapping[str, C],
    parallel: int,
    *,
    retry: bool = False,
    observer: Observer = UNOBSERVED,
) -> list[Record]:
    """Execute the runs that are missing in the folder; return the rows of all runs by name.

    `perform`: executes and evaluates a case in a separate process. `retry`: also repeat runs that
    did not pass.

    After a first Ctrl-C, KeyboardInterrupt is raised when the active runs have ended; after a
    second one, immediately. Raises ScenarioError if the folder was created with other facts, never
    for a run that fails.
    """
    folder = place.path
    with held_folder(folder):
        if claim(folder, place.what, place.facts):
            shutil.rmtree(folder / RUNS, ignore_errors=True)
        stores.write_state(folder, {**place.facts, "versions": versions()})
        namespaces.sweep()
        with Store(folder, UNITS) as store:
            try:
                opened = partial(processes, parallel)
                run_named(perform, cases, store, opened, observer, retry=retry, died=_died)
            finally:
                with stop_on_signal(lambda: None):
                    namespaces.sweep()  # of workers that were killed
        found = stores.rows(folder)
        records = [found[name] for name in sorted(found)]
        stores.write_table(folder / TABLE, records, UNITS)
    return records


def fingerprint(*files: Path) -> str:
    """A hash of what is in these files."""
    return sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest()


def _died(name: str, why: str) -> StudyRow:
    """The row of a run whose process died."""
    return StudyRow(name, {"faults": "", "verdict": str(Word.ERROR)}, (), False, why)


def _facts(job: SoakSetup) -> dict[str, Any]:
    """Facts that distinguish this folder from that of another soak test."""
    return {
        "title": job.soak.spec.title,
        "scenario": str(job.scenario),
        "deployment": str(job.deployment),
        "settings": list(job.changes),
        "seed": job.seed,
        "network": job.network,
        "fingerprint": fingerprint(job.scenario, job.deployment, job.soak.path),
    }
