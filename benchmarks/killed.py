"""Kills `cosim run` at random moments and measures what is lost.

    python benchmarks/killed.py --kills 200 --parallel 4 --seed 1 --out killed.jsonl

A run of the teleoperator lasts longer than 30 s of wall time: most are paced by a component that
sleeps, every fourth goes as fast as it can. At a moment drawn from 0 to 30 s after the recording
has begun SIGKILL is sent to the command, to the process that works for it, or to both. The
component records the clock in every row, so the loss is the time from the last recorded row to the
kill. Each folder has to be readable as it is and after `cosim report --recover`, row by row from
t = 0 and with its link tables, and no more than 1 s may be lost; the exit code is 1 where that
fails. Each kill adds a line to the file `--out`; the same
command makes the kills that the file does not have yet.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cosim.base.clock import monotonic_ns, sleep
from cosim.base.component import Kind, Outputs, Parameter, Port, Values
from cosim.base.errors import CosimError
from cosim.engine.recovery import repair
from cosim.links.storage import load_table
from cosim.record import Run

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "configs" / "teleoperation.toml"
COMMAND = [sys.executable, "-c", "from cosim.cli import main; main()"]
LENGTH = 30.0  # s of wall time within which a kill is drawn
ALLOWED = 1.0  # s that may be lost
PERIOD = 5  # ticks between two rows of a link's table
KINDS = ("the command", "the working process", "both")
PACER = """
[components.pacer]
model = "benchmarks.killed:Paced"
period = "{}"
parameters = {{ pause = {} }}
"""


class Paced:
    """Sampled: gives the monotonic clock, s, after a pause of `pause` s."""

    kind: Kind = "sampled"
    inputs: tuple[Port, ...] = ()
    outputs = (Port("wall", (), "s"),)
    parameters = (Parameter("pause", (0.0,), (), "s"),)

    def initialize(self, values: Values) -> None:
        """Take the parameter."""
        self._pause = float(values["pause"])

    def initial(self, u: Values) -> Outputs:
        """The clock."""
        return {"wall": np.array(monotonic_ns() * 1e-9)}

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """The clock, later."""
        sleep(self._pause)
        return self.initial(u)


def kill(index: int, seed: int, scratch: Path) -> dict[str, Any]:
    """One run, killed at a random moment; what was found."""
    draw = random.Random(f"{seed} {index}")
    moment, kind, fast = draw.uniform(0.0, LENGTH), KINDS[index % 3], index % 4 == 3
    folder = scratch / f"{index}"
    scenario = scratch / f"{index}.toml"
    pacer = PACER.format("1 ms", 0) if fast else PACER.format("10 ms", 0.01)
    document = CONFIG.read_text(encoding="utf-8").replace('"../', f'"{CONFIG.parent.parent}/')
    scenario.write_text(document + pacer, encoding="utf-8")
    stop = "1e5" if fast else "60"
    process = subprocess.Popen(
        [*COMMAND, "run", str(scenario), "--quiet", "--no-plot", "--out", str(folder),
         "--set", f"run.stop={stop}"],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while not (folder / "run.json").exists() and process.poll() is None:
        sleep(0.01)
    sleep(moment)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    workers = [int(child) for child in children]
    at = monotonic_ns() * 1e-9
    for pid in {KINDS[0]: [process.pid], KINDS[1]: workers}.get(kind, [*workers, process.pid]):
        os.kill(pid, signal.SIGKILL)
    said = process.communicate(timeout=60)[1]
    _gone(workers)
    found = {
        "index": index,
        "kind": kind,
        "fast": fast,
        "moment": moment,
        "code": process.returncode,
    }
    return found | _read(folder, at, said)


def _gone(pids: list[int]) -> None:
    """Wait until these processes have ended."""
    for pid in pids:
        while Path(f"/proc/{pid}").exists():
            sleep(0.01)


def _read(folder: Path, at: float, said: str) -> dict[str, Any]:
    """What is left of a run that was killed at `at`, as it is and recovered."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            first = Run.open(folder)
            t, wall = first.t, first.column("pacer.wall")
            tables = [load_table(path)[1].size for path in first.link_tables.values()]
            repair(folder)
            again = Run.open(folder)
        loss = at - float(wall[-1]) if len(first) else 0.0
        wrong = []
        if not np.array_equal(t, np.arange(len(t)) * 1e-3):
            wrong.append("ticks are missing")
        if len(tables) != 2 or PERIOD * min(tables) < len(t) - 1:
            wrong.append(f"link tables of {tables} rows for {len(t)} ticks")
        if not np.array_equal(again.t, t) or not np.array_equal(again.column("pacer.wall"), wall):
            wrong.append("recovered otherwise than read")
        if not all(np.isfinite(first.column(name)).all() for name in first.names):
            wrong.append("values that are not finite")
        return {"rows": len(t), "loss": max(loss, 0.0), "error": "; ".join(wrong)}
    except CosimError as error:
        return {"rows": 0, "loss": LENGTH, "error": f"{error} ({said.strip()})"}


def table(rows: list[dict[str, Any]]) -> list[str]:
    """The results as Markdown."""
    lines = ["| killed | speed | kills | not readable | worst loss (s) |"]
    lines += ["|---|---|---|---|---|"]
    for kind in KINDS:
        for fast in (False, True):
            some = [r for r in rows if r["kind"] == kind and r["fast"] == fast]
            bad = sum(bool(r["error"]) for r in some)
            worst = max((r["loss"] for r in some), default=0.0)
            speed = "full" if fast else "paced"
            lines.append(f"| {kind} | {speed} | {len(some)} | {bad} | {worst:.3f} |")
    return lines


def main() -> None:
    """Kill, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--parallel", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("killed.jsonl"))
    said = parser.parse_args()
    rows = []
    if said.out.exists():
        rows = [json.loads(line) for line in said.out.read_text().splitlines()]
    done, lock = {row["index"] for row in rows}, threading.Lock()
    with TemporaryDirectory() as scratch, ThreadPoolExecutor(said.parallel) as pool:

        def one(index: int) -> None:
            row = kill(index, said.seed, Path(scratch))
            with lock, said.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
                rows.append(row)

        list(pool.map(one, [i for i in range(said.kills) if i not in done]))
    print("\n".join(table(rows)))
    bad = [row for row in rows if row["error"] or row["loss"] > ALLOWED]
    for row in bad:
        print(f"kill {row['index']}: {row['error'] or 'too much lost'} ({row['loss']:.3f} s)")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
