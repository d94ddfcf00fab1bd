"""A soak: runs side by side until their time adds up, each once, whatever ends the process."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from functools import partial
from hashlib import sha256
from math import ceil
from pathlib import Path
from typing import Any

from bridge.campaign.soak import RUNS, SoakSetup, run_soak
from bridge.relay import namespaces
from bridge.results.verdict import Word
from cosim.base.interrupts import stop_on_signal
from cosim.base.processes import processes
from cosim.engine.simulate import versions
from cosim.study import store as stores
from cosim.study.run_point import StudyRow
from cosim.study.runner import UNOBSERVED, Observer, claim, run_named
from cosim.study.store import Store

#: Of the measures of a run, besides numbers of faults.
UNITS: Mapping[str, str] = {"s": "s", "torque": "N.m", "late_p99_ms": "ms", "together": "rad"}
TABLE, SUMMARY = "soak.parquet", "summary.md"
Record = dict[str, Any]


def count(hours: float, seconds: float) -> int:
    """Runs of so many seconds that make so many hours."""
    return max(1, ceil(hours * 3600.0 / seconds))


def soak(
    job: SoakSetup,
    runs: int,
    parallel: int,
    retry: bool = False,
    observer: Observer = UNOBSERVED,
) -> list[Record]:
    """All runs of a soak; see :func:`drive`."""
    return drive(
        job.folder, "soak test", _facts(job), partial(run_soak, job), runs, parallel,
        retry=retry, observer=observer,
    )  # fmt: skip


def drive(
    folder: Path,
    what: str,
    facts: Mapping[str, Any],
    perform: Callable[[int], StudyRow],
    runs: int,
    parallel: int,
    *,
    retry: bool = False,
    observer: Observer = UNOBSERVED,
) -> list[Record]:
    """Execute the runs that are missing in the folder; return the rows of all runs in their order.

    `what` the folder is for, in messages; `facts`: distinguish this folder from others. `perform`:
    executes and evaluates run k in a separate process. `retry`: also repeat runs that did not pass.

    After a first Ctrl-C, KeyboardInterrupt is raised when the active runs have ended; after a
    second one, immediately. Raises ScenarioError if the folder was created with other facts, never
    for a run that fails.
    """
    with stores.lock_folder(folder):
        if claim(folder, what, facts):
            shutil.rmtree(folder / RUNS, ignore_errors=True)
        stores.write_state(folder, {**facts, "versions": versions()})
        namespaces.sweep()
        with Store(folder, UNITS) as store:
            try:
                run_named(
                    perform, {f"{k:05d}": k for k in range(runs)}, store,
                    partial(processes, parallel), observer, retry=retry, died=_died,
                )  # fmt: skip
            finally:
                with stop_on_signal(lambda: None):
                    namespaces.sweep()  # of workers that were killed
        found = stores.rows(folder)
        records = [found[name] for name in sorted(found)]
        stores.write_table(folder / TABLE, records, UNITS)
    return records


def _died(name: str, why: str) -> StudyRow:
    """The row of a run whose process died."""
    return StudyRow(name, {"faults": "", "verdict": str(Word.ERROR)}, (), False, why)


def _facts(job: SoakSetup) -> dict[str, Any]:
    """Facts that distinguish this folder from that of another soak test."""
    files = (job.scenario, job.deployment, job.soak.path)
    return {
        "title": job.soak.spec.title,
        "scenario": str(job.scenario),
        "deployment": str(job.deployment),
        "settings": list(job.changes),
        "seed": job.seed,
        "network": job.network,
        "fingerprint": sha256(b"\0".join(f.read_bytes() for f in files)).hexdigest(),
    }
