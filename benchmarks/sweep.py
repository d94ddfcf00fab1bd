"""Many runs: how many a second, by kind and number of workers, and next to a loop over FMPy.

    python benchmarks/sweep.py [--quick] [--json FILE] [--runs N] [--study FILE] [--large]

The runs are ``configs/teleoperation.toml``, 60 s each, with the links' delays drawn anew; `--study`
measures another study instead. All of a sweep is timed: check, workers, runs, results on disk.
`--large`: only one sweep, with a process for each core; its processor time, its memory while it
runs, and how long a million runs would take.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
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
from cosim.base.processes import processes
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.study.execute import Extent, sweep
from cosim.study.runner import Observer
from cosim.study.study import Study, load_study
from cosim.study.workers import threads

SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "teleoperation.toml"
WORKERS = {"processes": processes, "threads": threads}
#: Two loops of Python bytecode at once, over one: what the machine's processors are worth.
SPIN = "sum(i * i for i in range(10_000_000))"


def timed(study: Study, kind: str, jobs: int, runs: int) -> dict[str, Any]:
    """One sweep of `runs` runs into a folder of its own."""
    with tempfile.TemporaryDirectory(prefix="sweep-") as folder:
        watch = stopwatch()
        opened = partial(WORKERS[kind], jobs)
        table = sweep(study, Path(folder, "out"), opened, Extent(limit=runs))
        seconds = watch()
    failed = sum(bool(r["reason"]) for r in table.records)
    return {
        "workers": kind, "jobs": jobs, "runs": len(table.records), "failed": failed,
        "wall": seconds, "rate": len(table.records) / seconds,
    }  # fmt: skip


def large(study: Study, runs: int) -> dict[str, Any]:
    """One sweep with all cores: `cpu` s of all processes a run, `memory` MB of this one by runs."""
    memory: dict[int, int] = {}
    count = 0

    def done(_: object) -> None:
        nonlocal count
        count += 1
        if count == 1 or 10 * count % runs < 10:
            memory[count] = _resident()

    jobs = os.cpu_count() or 2
    with tempfile.TemporaryDirectory(prefix="sweep-") as folder:
        before, watch = _processor(), stopwatch()
        opened = partial(WORKERS["processes"], jobs)
        table = sweep(study, Path(folder, "out"), opened, Extent(limit=runs), Observer(done=done))
        seconds, cpu = watch(), _processor() - before
    n = len(table.records)
    return {
        "jobs": jobs, "runs": n, "wall": seconds, "rate": n / seconds, "cpu": cpu / n,
        "memory": memory, "peak": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "million_hours": seconds / n * 1e6 / 3600,
        "million_hours_alone": cpu / n / jobs * 1e6 / 3600,
    }  # fmt: skip


def _processor() -> float:
    """Processor time of this process and of those that have ended, s."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(x.ru_utime + x.ru_stime for x in used)


def _resident() -> int:
    """Memory of this process now, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") >> 20


def report_large(r: dict[str, Any]) -> str:
    """In words."""
    memory = ", ".join(f"{mb} MB after {n}" for n, mb in r["memory"].items())
    return (
        f"{r['runs']} runs in {r['wall']:.1f} s by {r['jobs']} processes: {r['rate']:.1f} runs/s, "
        f"{1e3 * r['cpu']:.2f} ms of processor time a run\n"
        f"a million: {r['million_hours']:.2f} h at this rate, {r['million_hours_alone']:.2f} h if "
        f"the processors had nothing else to do\nmemory: {memory}; {r['peak']} MB at the end"
    )


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
    parser.add_argument("--large", action="store_true", help="one sweep with all cores only")
    options = parser.parse_args()
    runs, stop = (6, "2 s") if options.quick else (options.runs, "60 s")
    found: dict[str, Any] = {"load": list(os.getloadavg()), "processors": processors()}
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        study = load_study(options.study) if options.study else study_of(runs, stop, Path(folder))
        if options.large:
            found |= {"large": large(study, runs), "machine": tables.machine()}
            print(report_large(found["large"]))
            _write(options.json, found)
            return
        found["sweeps"] = [
            timed(study, kind, jobs, runs) for kind in WORKERS for jobs in (1, os.cpu_count() or 2)
        ]
    found["fmpy"] = naive(1 if options.quick else 3, stop)
    found["machine"] = tables.machine()
    print(report(found))
    _write(options.json, found)


def _write(path: Path | None, found: dict[str, Any]) -> None:
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
