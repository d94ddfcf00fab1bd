"""Checkpoints: the wall time and the bytes of one, what a run takes with them, and to resume it.

    python benchmarks/checkpoint.py [--rounds N] [--json FILE] [--quick]

Each run is made with and without checkpoints, in turns, in this process. "One" is the mean of a
run with a checkpoint after every chunk, with its wait for the recorder and the disk; "overhead":
by how much the best run with a checkpoint every second is longer than the best without. "Resume"
goes from the last checkpoint of a run to the next tick: it draws the tables again from their seeds
and writes the rows that were recorded before. The start of components is in none of them.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables

ROOT = Path(__file__).resolve().parents[1]
CASES = {
    "teleoperation": ("teleoperation.toml", 600.0, ()),
    "25 robots": ("many.toml", 120.0, ()),
    "1000 robots": ("many.toml", 10.0, ("graphs.net.n=1000",)),
}
HEADER = ("run", "simulated, s", "without, s", "overhead, %", "one, ms", "one, MB", "resume, s")


class Halfway(Exception):
    """A run is given up."""


def measure(name: str, rounds: int, scale: float) -> dict[str, Any]:
    """One row."""
    from cosim.checkpoint import CheckpointKeeper, Resumption
    from cosim.engine.simulate import Execution, simulate
    from cosim.loading.files import load

    file, stop, changes = CASES[name]
    scenario = load(ROOT / "configs" / file, (f"run.stop={stop * scale:g}", *changes))
    walls: dict[str, list[float]] = {"without": [], "with": []}

    def give_up(done: int, ticks: int) -> None:
        if done > 0.9 * ticks:
            raise Halfway

    with TemporaryDirectory() as folder:
        place = Path(folder) / "run"
        for _ in range(rounds):
            walls["without"].append(simulate(scenario, place, force=True).wall)
            execution = Execution(1, CheckpointKeeper(1.0, {}))
            walls["with"].append(simulate(scenario, place, force=True, execution=execution).wall)
        every = CheckpointKeeper(0.0, {})
        shutil.rmtree(place)
        try:
            simulate(scenario, place, give_up, execution=Execution(1, every))
        except Halfway:
            again = CheckpointKeeper(1e9, {}, Resumption.open(place))
            simulate(scenario, place, execution=Execution(1, again))
    best = {key: min(found) for key, found in walls.items()}
    return {
        "run": name, "seconds": stop * scale, "without": best["without"],
        "overhead": 100.0 * (best["with"] / best["without"] - 1.0),
        "one": every.spent / every.count, "bytes": every.size, "resume": again.resuming,
    }  # fmt: skip


def line(row: dict[str, Any]) -> Sequence[str]:
    """A row of the table."""
    return (
        row["run"], f"{row['seconds']:g}", f"{row['without']:.2f}", f"{row['overhead']:.1f}",
        f"{1e3 * row['one']:.1f}", f"{row['bytes'] / 1e6:.2f}", f"{row['resume']:.2f}",
    )  # fmt: skip


def main() -> None:
    """Measure, print the table, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true", help="only test that everything runs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    options = parser.parse_args()
    names = list(CASES)[:1] if options.quick else list(CASES)
    rounds, scale = (1, 0.05) if options.quick else (options.rounds, 1.0)
    rows = [measure(name, rounds, scale) for name in names]
    print(tables.grid(HEADER, [line(row) for row in rows]))
    if options.json:
        facts = {"machine": tables.machine(), "rows": rows}
        options.json.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
