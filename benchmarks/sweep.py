"""Many runs: how many a second, by kind and number of workers, and next to a loop over FMPy.

    python benchmarks/sweep.py [--quick] [--json FILE] [--runs N] [--study FILE]

The runs are ``configs/teleoperation.toml``, 60 s each, with the links' delays drawn anew; `--study`
measures another study instead. All of a sweep is timed: check, workers, runs, results on disk.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from benchmarks.fmpy_loop import Planned
from benchmarks.peers import Absent
from cosim.base.clock import stopwatch
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.sweeps.execute import sweep
from cosim.sweeps.study import Study, load_study
from cosim.sweeps.workers import processes, threads

SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "teleoperation.toml"
WORKERS = {"processes": processes, "threads": threads}
#: Two loops of Python bytecode at once, over one: what the machine's processors are worth.
SPIN = "sum(i * i for i in range(10_000_000))"


def timed(study: Study, kind: str, jobs: int, runs: int) -> dict[str, Any]:
    """One sweep of `runs` runs into a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="sweep-") as folder:
        watch = stopwatch()
        opened = partial(WORKERS[kind], jobs)
        table = sweep(study, Path(folder, "out"), opened, limit=runs)
        seconds = watch()
    failed = sum(bool(r["reason"]) for r in table.records)
    return {
        "workers": kind, "jobs": jobs, "runs": len(table.records), "failed": failed,
        "wall": seconds, "rate": len(table.records) / seconds,
    }  # fmt: skip


def naive(runs: int, stop: str) -> dict[str, Any] | None:
    """The same runs in a Python loop over FMPy, recording every tick in a list; None: no FMPy."""
    watch = stopwatch()
    try:
        for seed in range(runs):
            plan = assemble(load(SCENARIO, [f"run.seed={seed}", f"run.stop='{stop}'"]))
            session = Planned(plan, recorded=True)
            session.run(plan.ticks)
            session.close()
    except Absent:
        return None
    seconds = watch()
    return {"runs": runs, "wall": seconds, "rate": runs / seconds}


def processors() -> float:
    """How much faster two plain loops are done side by side than one after the other."""
    command = [sys.executable, "-c", SPIN]
    watch = stopwatch()
    for _ in range(2):
        subprocess.run(command, check=True)
    one = watch()
    watch = stopwatch()
    both = [subprocess.Popen(command) for _ in range(2)]
    for process in both:
        process.wait()
    return one / watch()


def study_of(runs: int, stop: str, folder: Path) -> Study:
    """The teleoperator, `runs` seeds."""
    path = folder / "seeds.toml"
    path.write_text(
        f"scenario = {json.dumps(str(SCENARIO))}\nseeds = {runs}\n"
        f'settings = ["run.record.every=5", "run.stop=\'{stop}\'"]\n',
        encoding="utf-8",
    )
    return load_study(path)


def report(found: dict[str, Any]) -> str:
    """The table."""
    one = {r["workers"]: r["wall"] / r["runs"] for r in found["sweeps"] if r["jobs"] == 1}
    rows = [
        [
            f"{r['jobs']} {r['workers']}", str(r["runs"]), f"{r['wall']:.1f}", f"{r['rate']:.1f}",
            f"{one[r['workers']] * r['rate']:.2f}",
        ]
        for r in found["sweeps"]
    ]  # fmt: skip
    if found["fmpy"]:
        r = found["fmpy"]
        rows.append(["FMPy, loop in Python", str(r["runs"]), f"{r['wall']:.1f}",
                     f"{r['rate']:.2g}", ""])  # fmt: skip
    table = tables.grid(["workers", "runs", "s", "runs/s", "over one"], rows)
    return f"{table}\n\ntwo plain loops side by side: {found['processors']:.2f} times one"


def main() -> None:
    """Measure, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a few short runs of everything")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--runs", type=int, default=1000, help="runs of each (default 1000)")
    parser.add_argument("--study", type=Path, metavar="FILE", help="measure this study")
    options = parser.parse_args()
    runs, stop = (6, "2 s") if options.quick else (options.runs, "60 s")
    found: dict[str, Any] = {"load": list(os.getloadavg()), "processors": processors()}
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        study = load_study(options.study) if options.study else study_of(runs, stop, Path(folder))
        found["sweeps"] = [
            timed(study, kind, jobs, runs) for kind in WORKERS for jobs in (1, os.cpu_count() or 2)
        ]
    found["fmpy"] = naive(1 if options.quick else 3, stop)
    found["machine"] = tables.machine()
    print(report(found))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
