"""The teleoperator from start to finish: x real time, time of each stage, and memory.

    python benchmarks/teleoperation.py [--quick] [--json FILE] [--rounds N]

Measures ``cosim run configs/teleoperation.toml`` in separate processes.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from time import perf_counter

from benchmarks import tables

Environment = dict[str, str]

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "configs" / "teleoperation.toml"
COMMAND = f"import sys; sys.path.append({str(ROOT)!r}); from cosim.cli import main; main()"
#: Lengths of run for the memory, s; and how seldom they record.
LENGTHS, EVERY = (60, 600, 6000), 1000


def environment(folder: Path) -> Environment:
    """As a user has it: compiled modules are kept."""
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    if sys.dont_write_bytecode and not sys.pycache_prefix:
        kept["PYTHONPYCACHEPREFIX"] = str(folder / "pycache")
    return kept


def staged(folder: Path, env: Environment, *settings: str) -> dict[str, Any]:
    """One run, stage by stage; adds the end of the process."""
    with tempfile.TemporaryDirectory(dir=folder) as out:
        script = str(Path(__file__).with_name("stages.py"))
        started = perf_counter()
        arguments = [repr(started), str(SCENARIO), str(Path(out, "run")), *settings]
        done = subprocess.run(
            [sys.executable, script, *arguments],
            env=env, capture_output=True, text=True, check=True,
        )  # fmt: skip
        end = perf_counter()
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    found["stages"]["end Python"] = {"wall": end - found["ended"], "cpu": float("nan")}
    found["total"] = end - started
    return found


def command(folder: Path, env: Environment, *options: str) -> tuple[float, float]:
    """Wall and processor s of the very command, from start to exit."""
    with tempfile.TemporaryDirectory(dir=folder) as out:
        arguments = ["run", str(SCENARIO), "--out", str(Path(out, "run")), *options]
        before, started = os.times(), perf_counter()
        subprocess.run(
            [sys.executable, "-c", COMMAND, *arguments],
            env=env, stdout=subprocess.DEVNULL, check=True,
        )  # fmt: skip
        wall, after = perf_counter() - started, os.times()
    used = after.children_user + after.children_system
    return wall, used - before.children_user - before.children_system


def measure(rounds: int, lengths: tuple[int, ...], stop: str) -> dict[str, Any]:
    """Everything, in turns."""
    with tempfile.TemporaryDirectory(prefix="teleoperation-") as name:
        folder = Path(name)
        env = environment(folder) if rounds > 1 else dict(os.environ)
        if rounds > 1:  # compiles modules, builds and unpacks FMUs
            staged(folder, env, stop)
            command(folder, env, "--set", stop)
        runs: list[dict[str, Any]] = []
        whole: list[tuple[float, float]] = []
        plain: list[tuple[float, float]] = []
        for _ in range(rounds):
            runs.append(staged(folder, env, stop))
            whole.append(command(folder, env, "--set", stop))
            plain.append(command(folder, env, "--set", stop, "--no-plot"))
        memory = {}
        for seconds in lengths:
            settings = [f"run.stop='{seconds} s'", f"run.record.every={EVERY}", "figures={}"]
            found = staged(folder, env, *settings)
            memory[str(seconds)] = {key: found[key] for key in ("peak_mb", "wall")}
    return {
        "seconds": runs[0]["seconds"],
        "wall": [r["wall"] for r in runs],
        "stages": {
            stage: {
                key: summary([r["stages"][stage][key] for r in runs]) for key in ("wall", "cpu")
            }
            for stage in runs[0]["stages"]
        },
        "total": summary([r["total"] for r in runs]),
        "command": {key: summary([w[i] for w in whole]) for i, key in enumerate(("wall", "cpu"))},
        "no_plot": {key: summary([w[i] for w in plain]) for i, key in enumerate(("wall", "cpu"))},
        "memory": memory,
    }


def summary(values: list[float]) -> dict[str, float]:
    """Best, median and worst."""
    return {"min": min(values), "median": median(values), "max": max(values)}


def report(found: dict[str, Any]) -> str:
    """The tables."""
    seconds, walls = found["seconds"], found["wall"]
    best, middle = seconds / min(walls), seconds / median(walls)
    parts = [
        f"### {seconds:g} s, recorded: {best:.0f} x real time at best, {middle:.0f} in the median",
        f"wall time {_ms(summary(walls))} ms (best, median, worst of {len(walls)})",
        "### From the start of the process to its end",
    ]
    rows = [[stage, _ms(s["wall"]), _ms(s["cpu"])] for stage, s in found["stages"].items()]
    rows += [["all of it", _ms(found["total"]), ""]]
    for key, title in (("command", "cosim run"), ("no_plot", "cosim run --no-plot")):
        rows.append([f"`{title}`", _ms(found[key]["wall"]), _ms(found[key]["cpu"])])
    header = ["stage", "wall ms: best, median, worst", "processor ms: best, median, worst"]
    parts += [tables.grid(header, rows), f"### Memory, every {EVERY}th tick recorded"]
    rows = [
        [f"{length} s", f"{m['peak_mb']:.1f}", f"{m['wall']:.3g}", f"{int(length) / m['wall']:.0f}"]
        for length, m in found["memory"].items()
    ]
    parts += [tables.grid(["run", "peak MB", "wall s", "x real time"], rows)]
    return "\n\n".join(parts)


def _ms(s: dict[str, float]) -> str:
    if s["min"] != s["min"]:
        return ""
    return ", ".join(f"{1e3 * s[key]:.0f}" for key in ("min", "median", "max"))


def main() -> None:
    """Measure, print the tables, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one short run of everything")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--rounds", type=int, default=9, help="runs of each (default 9)")
    options = parser.parse_args()
    rounds, lengths = (1, (4,)) if options.quick else (options.rounds, LENGTHS)
    found = measure(rounds, lengths, "run.stop='2 s'" if options.quick else "run.stop='60 s'")
    found["machine"] = tables.machine()
    print(report(found))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
