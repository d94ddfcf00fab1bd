"""What commands cost before they compute anything, as multiples of the start of Python.

    python benchmarks/startup.py [--rounds 10] [--quick] [--json FILE]

Processor time (user and system time of a process and its children) of ``cosim --help``, ``cosim
check``, ``cosim run --no-plot`` and ``cosim run`` (with its report) of
`configs/teleoperation.toml`, in turns with ``python -c pass``. Other work on the machine changes
it less than wall time, but it does. An editable installation makes the start of Python itself
twice as long, and the multiples smaller.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

from benchmarks import tables
from benchmarks.teleoperation import COMMAND, SCENARIO, Environment, environment

#: The first is the unit of the others; the last is given a new folder for its results.
COMMANDS: dict[str, Sequence[str]] = {
    "python -c pass": ("pass",),
    "cosim --help": (COMMAND, "--help"),
    "cosim check": (COMMAND, "check", str(SCENARIO)),
    "cosim run --no-plot": (COMMAND, "run", str(SCENARIO), "--no-plot", "--quiet", "--out"),
    "cosim run": (COMMAND, "run", str(SCENARIO), "--quiet", "--out"),
}


def spent(words: Sequence[str], env: Environment) -> float:
    """Processor time of one process and its children, s."""
    with TemporaryDirectory() as folder:
        new = [str(Path(folder, "run"))] if words[-1] == "--out" else []
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-c", *words, *new], env=env, stdout=subprocess.DEVNULL, check=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def measure(rounds: int, folder: Path) -> dict[str, Any]:
    """Processor seconds of every command, round after round."""
    env = environment(folder)
    for words in COMMANDS.values():  # compiled modules and FMUs are kept from here on
        spent(words, env)
    found: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(rounds):
        for name, words in COMMANDS.items():
            found[name].append(spent(words, env))
    return {"machine": tables.machine(), "seconds": found}


def report(result: dict[str, Any]) -> str:
    """Median and least milliseconds of each command, and both as multiples of the first."""
    seconds: dict[str, list[float]] = result["seconds"]
    units = next(iter(seconds.values()))
    rows = [
        [
            name, f"{1e3 * median(found):.0f}", f"{1e3 * min(found):.0f}",
            f"{median(found) / median(units):.1f}", f"{min(found) / min(units):.1f}",
        ]
        for name, found in seconds.items()
    ]  # fmt: skip
    header = ["processor time", "median, ms", "least, ms", "multiple of median", "of least"]
    return tables.grid(header, rows)


def main() -> None:
    """Measure, print, keep."""
    parser = argparse.ArgumentParser(description="Processor time of commands that compute little.")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--quick", action="store_true", help="One round.")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        result = measure(1 if options.quick else options.rounds, Path(folder))
    load = result["machine"]["load"]
    print(report(result))
    print(f"\nload of the machine: {load[0]:.1f}" if load else "")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
