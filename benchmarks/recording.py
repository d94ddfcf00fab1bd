"""What a recording that survives `kill -9` costs, next to another version of this project.

    python benchmarks/recording.py --before /path/to/the/other/tree [--rounds 15]

Both versions take turns, so that what else the machine does hits both alike; the medians, and the
median of the ratio within each turn, are printed. Two cases: the command `cosim run --no-plot` from
the start of the process to its end, and the engine with its recorder alone over a run of about ten
seconds of wall time (`--seconds`). `--before` is a tree with built libraries (`pip install -e .`).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from cosim.base.clock import stopwatch

ROOT = Path(__file__).resolve().parents[1]
CONFIG = "configs/teleoperation.toml"
COMMAND = "from cosim.cli import main; main()"
ENGINE = """
import sys
from pathlib import Path
from cosim.scenario.spec import load
from cosim.engine.simulate import simulate
print(simulate(load(Path(sys.argv[1]), [f"run.stop={sys.argv[3]}"]), Path(sys.argv[2])).wall)
"""


def called(tree: Path, code: str, *arguments: str) -> str:
    """Run a piece of Python over the packages of `tree`; what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout


def command(tree: Path, folder: Path, stop: str) -> float:
    """Wall seconds of `cosim run --no-plot`, from the start of the process to its end."""
    watch = stopwatch()
    called(tree, COMMAND, "run", CONFIG, "--no-plot", "--quiet", "--out", str(folder))
    return watch()


def engine(tree: Path, folder: Path, stop: str) -> float:
    """Wall seconds of the loop and its recorder, until the trajectories are complete."""
    return float(called(tree, ENGINE, CONFIG, str(folder), stop))


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--before", type=Path, required=True)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--stop", default="6000", help="simulated seconds of the engine's run")
    said = parser.parse_args()
    print("| case | before (s) | now (s) | ratio of medians | median of ratios |")
    print("|---|---|---|---|---|")
    for case in (command, engine):
        times: dict[Path, list[float]] = {said.before: [], ROOT: []}
        for turn in range(said.rounds):
            order = list(times) if turn % 2 else list(times)[::-1]
            for tree in order:
                with TemporaryDirectory(dir=Path.cwd()) as folder:
                    times[tree].append(case(tree, Path(folder) / "run", said.stop))
        a, b = times[said.before], times[ROOT]
        ratio = median(y / x for x, y in zip(a, b, strict=True))
        print(
            f"| {case.__name__} | {median(a):.3f} | {median(b):.3f} | "
            f"{median(b) / median(a):.3f} | {ratio:.3f} |"
        )


if __name__ == "__main__":
    main()
