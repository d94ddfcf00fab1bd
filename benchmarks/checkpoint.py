"""Checkpoints: what one costs, what a run takes with them, and what they save when it is killed.

    python benchmarks/checkpoint.py [--rounds N] [--json FILE] [--quick]

Everything is measured in turns, in this process. "One": the mean of a run with a checkpoint after
every chunk, with its wait for the recorder and the disk, without the first one; "overhead": by how
much the best run with a checkpoint every second is longer than the best without. "Resume" goes from
the last checkpoint to the next tick: it draws the tables again from their seeds and writes the rows
before once more. A run that is killed halfway, as a whole: the first half, and then the rest from
its last checkpoint (one after every seventh of the run, so that half an interval is lost), or
"again" from the beginning. The start of components is
in none of them, but in the first half.

"FMPy" is what its user can save of the same FMUs: ``getFMUstate``, ``serializeFMUstate`` and
``freeFMUstate`` of each, all in one file by ``pickle``, brought to the disk. It has neither links
nor rows; "FMUs": the same, of ours.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from benchmarks.peers import Absent, units

ROOT = Path(__file__).resolve().parents[1]
CASES = {
    "teleoperation": ("teleoperation.toml", 2000.0, ()),
    "25 robots": ("many.toml", 120.0, ()),
    "1000 robots": ("many.toml", 10.0, ("graphs.net.n=1000",)),
}
HEADER = ("run", "simulated, s", "without, s", "overhead, %", "one, ms", "one, MB", "resume, s",
          "killed halfway: resumed, s", "again, s", "FMUs: ours, ms", "FMPy, ms")  # fmt: skip


class Halfway(Exception):
    """A run is given up."""


def halfway(done: int, ticks: int) -> None:
    """Give a run up after half of its ticks."""
    if done > ticks // 2:
        raise Halfway


def killed(scenario: Any, place: Path, interval: float | None) -> tuple[float, float]:
    """The time (s) of a run that is killed halfway, in all, and of resuming it.

    `interval` (s of the run): between its checkpoints; None: it has none, and begins again.
    """
    from cosim.base.clock import stopwatch
    from cosim.checkpoint import CheckpointInterval, CheckpointKeeper, Resumption
    from cosim.engine.simulate import Execution, simulate

    shutil.rmtree(place, ignore_errors=True)
    every = None if interval is None else CheckpointInterval(interval, simulated=True)
    keeper = None if every is None else CheckpointKeeper(every, {})
    watch = stopwatch()
    try:
        simulate(scenario, place, halfway, execution=Execution(1, keeper))
    except Halfway:
        first = watch()
    if every is None:
        return first + simulate(scenario, place, force=True).wall, 0.0
    again = CheckpointKeeper(every, {}, Resumption.open(place))
    outcome = simulate(scenario, place, execution=Execution(1, again))
    return first + outcome.wall - again.before, again.resuming


def one(scenario: Any, place: Path) -> tuple[float, int]:
    """The mean time (s) of a checkpoint after every chunk, and the bytes of the last one."""
    from cosim.checkpoint import CheckpointInterval, CheckpointKeeper
    from cosim.engine.simulate import Execution, simulate

    every = CheckpointKeeper(CheckpointInterval(0.0), {})
    shutil.rmtree(place, ignore_errors=True)
    simulate(scenario, place, execution=Execution(1, every))
    return every.spent / every.count, every.size


def written(path: Path, states: Sequence[bytes]) -> None:
    """States in one file, brought to the disk."""
    with path.open("wb") as file:
        pickle.dump(states, file, protocol=5)
        file.flush()
        os.fsync(file.fileno())


def of_fmus(scenario: Any, path: Path, rounds: int) -> tuple[float, float]:
    """The best time (s) to save all FMUs, ours and FMPy's, in turns."""
    from benchmarks.fmpy_loop import Slaves
    from cosim.base.clock import stopwatch
    from cosim.engine.engine import Engine
    from cosim.fmi import components
    from cosim.scenario.assemble import assemble

    plan = assemble(scenario)
    times: tuple[list[float], list[float]] = ([], [])
    with Engine(plan) as engine:
        engine.initialize()
        slaves = Slaves(units(plan, links=True))
        for _ in range(3 * rounds):
            watch = stopwatch()
            written(path, [components.serialized(x.component)[0] for x in plan.components])
            times[0].append(watch())
            watch = stopwatch()
            states = []
            for fmu in slaves.fmus:
                state = fmu.getFMUstate()
                states.append(fmu.serializeFMUstate(state))
                fmu.freeFMUstate(state)
            written(path, states)
            times[1].append(watch())
        slaves.close()
    return min(times[0]), min(times[1])


def measure(name: str, rounds: int, scale: float) -> dict[str, Any]:
    """One row."""
    from cosim.checkpoint import CheckpointInterval, CheckpointKeeper
    from cosim.engine.simulate import Execution, simulate
    from cosim.loading.files import load

    file, stop, changes = CASES[name]
    scenario = load(ROOT / "configs" / file, (f"run.stop={stop * scale:g}", *changes))
    found: dict[str, list[float]] = {}

    def note(key: str, value: float) -> None:
        found.setdefault(key, []).append(value)

    with TemporaryDirectory() as folder:
        place = Path(folder) / "run"
        for _ in range(rounds):
            note("without", simulate(scenario, place, force=True).wall)
            keeper = Execution(1, CheckpointKeeper(CheckpointInterval(1.0), {}))
            note("with", simulate(scenario, place, force=True, execution=keeper).wall)
            seconds, size = one(scenario, place)
            note("one", seconds)
            whole, resuming = killed(scenario, place, stop * scale / 7.0)
            note("resumed", whole)
            note("resume", resuming)
            note("again", killed(scenario, place, None)[0])
        try:
            ours, fmpy = of_fmus(scenario, Path(folder) / "states", rounds)
        except Absent as error:
            print(f"FMPy: {error}", file=sys.stderr)
            ours = fmpy = float("nan")
    best = {key: min(values) for key, values in found.items()}
    return {
        "run": name, "seconds": stop * scale, "bytes": size, "fmus": ours, "fmpy": fmpy,
        "overhead": 100.0 * (best["with"] / best["without"] - 1.0), **best,
        "median": {key: median(values) for key, values in found.items()},
    }  # fmt: skip


def line(row: dict[str, Any]) -> Sequence[str]:
    """A row of the table."""
    return (
        row["run"], f"{row['seconds']:g}", f"{row['without']:.2f}", f"{row['overhead']:.1f}",
        f"{1e3 * row['one']:.1f}", f"{row['bytes'] / 1e6:.2f}", f"{row['resume']:.2f}",
        f"{row['resumed']:.2f}", f"{row['again']:.2f}", f"{1e3 * row['fmus']:.1f}",
        f"{1e3 * row['fmpy']:.1f}",
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
