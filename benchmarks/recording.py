"""What recording so that nothing is lost costs: processor time, in turns, in this tree alone.

    python benchmarks/recording.py [--rounds 40] [--long 12] [--quick] [--json FILE]

Variants take turns in random order, each run in a new process, and all import the same modules:

* *as it is*: what users have. It is there twice: the second ratio shows what differs by chance.
* *in memory*: rows and link tables are kept in memory of the process and written to Parquet at the
  end, and ``run.json`` is written once, at the end. Killed, such a run leaves nothing that can be
  read; the result of a run that finishes is the same. The difference is what the recording costs.
* *in memory, alone*: in addition the command is not watched by a second process.

Two cases: `cosim run configs/teleoperation.toml --no-plot`, from the start of the process to its
end with all its children; and a run of the engine with its recorder of about ten seconds of wall
time, of which only :func:`cosim.engine.simulate.simulate` is measured (`--stop`: its length in
simulated seconds). Processor time is user and system time of all threads.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

from benchmarks import tables
from benchmarks.recording_work import ALONE, COMMAND, ENGINE, MEMORY
from benchmarks.teleoperation import Environment, environment

WORK = Path(__file__).with_name("recording_work.py")
AS_IT_IS, AGAIN = "as it is", "as it is, again"
#: The variants of a case; ratios are to the third.
CASES = {
    COMMAND: (AS_IT_IS, AGAIN, MEMORY, ALONE),
    ENGINE: (AS_IT_IS, AGAIN, MEMORY),
}
GOAL = 1.03  # of the median of ratios to MEMORY
STATED = 1.96  # standard deviations either side of 95 %


def measured(case: str, variant: str, stop: str, env: Environment) -> tuple[float, float]:
    """Processor and wall seconds of one run in a process of its own."""
    import time

    with TemporaryDirectory(dir=Path.cwd(), prefix="recording-") as folder:
        call = [sys.executable, str(WORK), case, variant, f"{folder}/run", stop]
        begin = time.perf_counter()
        process = subprocess.Popen(call, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert process.stdout is not None
        said = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        process.stdout.close()
        if process.returncode:
            raise SystemExit(f"{case}, {variant}: exit code {process.returncode}")
    if case == ENGINE:
        cpu, wall = json.loads(said)
        return cpu, wall
    return used.ru_utime + used.ru_stime, wall


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest value that `share` of all do not exceed."""
    found = sorted(values)
    return found[min(len(found) - 1, int(share * len(found)))]


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Of the median, 95 %, by order statistics."""
    found, n = sorted(values), len(values)
    rank = max(0, int((n - STATED * n**0.5) / 2))
    return found[rank], found[n - 1 - rank]


def run(case: str, rounds: int, stop: str, env: Environment) -> dict[str, list[list[float]]]:
    """(processor, wall) of every round of every variant."""
    draw = random.Random(case)
    times: dict[str, list[list[float]]] = {variant: [] for variant in CASES[case]}
    for turn in range(-1, rounds):
        for variant in draw.sample(list(times), len(times)):
            found = measured(case, variant, stop, env)
            if turn >= 0:  # the first compiles modules and unpacks FMUs
                times[variant].append(list(found))
    return times


def rows(times: dict[str, list[list[float]]]) -> list[list[str]]:
    """A row each variant: processor s, wall s, and the ratio to MEMORY within a round."""
    made = []
    for variant, found in times.items():
        cpu, wall = zip(*found, strict=True)
        cells = [variant, *(f"{median(x):.3f} / {percentile(x, 0.99):.3f}" for x in (cpu, wall))]
        ratios = [a[0] / b[0] for a, b in zip(found, times[MEMORY], strict=True)]
        least, most = interval(ratios)
        cells.append("1" if variant == MEMORY else f"{median(ratios):.3f} ({least:.3f}–{most:.3f})")
        whole = median(cpu) / median(b[0] for b in times[MEMORY])
        made.append([*cells, f"{whole:.3f}"])
    return made


def main() -> None:
    """Measure and print a table; exit code 1 where a cost is surely above the goal."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=40, help="of the command; 0: none")
    parser.add_argument(
        "--long", type=int, default=12, help="rounds of the engine's run; 0: leave it out"
    )
    parser.add_argument("--stop", default="10000", help="simulated seconds of the engine's run")
    parser.add_argument("--quick", action="store_true", help="shows only that everything runs")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    said = parser.parse_args()
    machine, dear = tables.machine(), False
    found: dict[str, Any] = {}
    print(f"{machine['processor']}, {machine['cores']} cores, {machine['system']}, Python "
          f"{machine['python']}, pyarrow {machine['packages']['pyarrow']}, cosim-bridge "
          f"{machine['cosim']}; load {machine['load']}\n")  # fmt: skip
    with TemporaryDirectory(prefix="recording-") as name:
        env = environment(Path(name))
        for case, rounds, stop in (
            (COMMAND, said.rounds, "60"), (ENGINE, said.long, said.stop)
        ):  # fmt: skip
            if not rounds:
                continue
            short = (2, "2") if said.quick else (rounds, stop)
            times = found[case] = run(case, *short, env)
            head = [
                f"{case}, {short[1]} s, {short[0]} rounds",
                "processor s, median / p99",
                "wall s, likewise",
            ]
            head += ["ratio to *in memory*, median of rounds (95 %)", "ratio of medians"]
            print(tables.grid(head, rows(times)) + "\n")
            ratios = [a[0] / b[0] for a, b in zip(times[AS_IT_IS], times[MEMORY], strict=True)]
            dear |= interval(ratios)[0] > GOAL
    if said.json:
        said.json.write_text(json.dumps({"machine": machine, "times": found}, indent=1) + "\n")
    sys.exit(dear and not said.quick)


if __name__ == "__main__":
    main()
