"""The same runs by GNU parallel and `cosim run`, by parts of a sweep, and by one call of it.

    python benchmarks/parts.py [--runs N] [--parts N] [--rounds N] [--jobs N] [--stop TIME]

The runs are ``configs/teleoperation.toml`` with seeds 0 to N - 1, by two processes at a time, in
turns. All is timed, from the start of the first process to the table: what a shell user types. Bare
runs leave a run folder each and no table. The tables of parts and of one call are compared.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from cosim.base.clock import stopwatch

SCENARIO = Path(__file__).resolve().parents[1] / "configs" / "teleoperation.toml"
#: What each entrant types; the last two make a table.
COMMANDS = {
    "GNU parallel, cosim run": (
        "seq 0 {last} | {parallel} cosim run {scenario} --seed {{}} --stop {stop} --no-plot "
        "--quiet --out runs/{{}}"
    ),
    "GNU parallel, cosim sweep --part, --merge": (
        "seq {parts} | {parallel} cosim sweep study.toml --part {{}}/{parts} --jobs 1 --no-plot "
        "--quiet && cosim sweep study.toml --merge runs/study.parts/* --out table --no-plot --quiet"
    ),
    "cosim sweep": "cosim sweep study.toml --out table --jobs {jobs} --no-plot --quiet",
}


def timed(command: str, study: str) -> tuple[float, bytes]:
    """Seconds of a command in an empty folder, and the table that it leaves, empty: none."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    with tempfile.TemporaryDirectory(prefix="parts-") as folder:
        Path(folder, "study.toml").write_text(study, encoding="utf-8")
        watch = stopwatch()
        subprocess.run(
            ["bash", "-euo", "pipefail", "-c", command],
            cwd=folder, env=os.environ | {"PATH": path}, check=True, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        seconds = watch()
        table = Path(folder, "table/table.parquet")
        return seconds, table.read_bytes() if table.exists() else b""


def main() -> None:
    """Measure in turns and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--parts", type=int, default=8)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--stop", default="60", help="simulated time of a run, s")
    asked = parser.parse_args()
    if shutil.which("parallel") is None:
        sys.exit("GNU parallel is missing: apt-get install parallel")
    study = f"scenario = '{SCENARIO}'\nseeds = {asked.runs}\nsettings = ['run.stop={asked.stop}']\n"
    given = {
        **vars(asked), "last": asked.runs - 1, "scenario": SCENARIO,
        "parallel": f"parallel --will-cite -j {asked.jobs}",
    }  # fmt: skip
    seconds: dict[str, list[float]] = {name: [] for name in COMMANDS}
    made = set[bytes]()
    for _ in range(asked.rounds):
        for name, command in COMMANDS.items():
            took, table = timed(command.format(**given), study)
            seconds[name].append(took)
            made |= {table} - {b""}
    least = median(seconds["cosim sweep"])
    rows = [
        [
            name,
            f"{median(x):.2f}",
            f"{1e3 * median(x) / asked.runs:.1f}",
            f"{median(x) / least:.2f}",
        ]
        for name, x in seconds.items()
    ]
    heads = ["", "s", "ms a run", "to one sweep"]
    print(f"{asked.runs} runs of {asked.stop} s, {asked.parts} parts, {asked.jobs} at a time")
    print(tables.grid(heads, rows))
    print(f"tables: {'the same bytes' if len(made) == 1 else 'DIFFERENT'}; {tables.machine()}")


if __name__ == "__main__":
    main()
