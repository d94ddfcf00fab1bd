"""``python -m tests.mutants [--count N] [--seed S] [--least SHARE] [--only TEXT] [GROUP ...]``.

In a copy of the checkout, one small change after the other is made in the sources of a group, what
it reaches is built again, and tests run until one fails: those that execute the changed block of C
code (:mod:`tests.mutants.choice`), as many as the budget of time allows. A mutant that no test
notices has *survived*: its line is printed, and a test is missing there, or the change makes no
difference and belongs in ``tests/mutants/equivalent.toml``. One of which the compiler makes the
same as before is none. Exits with 1 where fewer than ``--least`` of the mutants of a group were
noticed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple
from pathlib import Path
from typing import Any

from tests.mutants.changes import Mutant, equivalent
from tests.mutants.groups import GROUPS
from tests.mutants.worker import SAME

ROOT = Path(__file__).resolve().parents[2]
LEFT_OUT = shutil.ignore_patterns(".git", ".venv", ".*_cache", "runs", ".hypothesis")
#: One thread for each process: the tests compute little, and forked processes have no others.
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def chosen(name: str, count: int, seed: int, only: str) -> list[Mutant]:
    """Mutants of a group, drawn at random; none of those known to make no difference."""
    known = equivalent()
    found = [m for m in GROUPS[name].mutants(ROOT) if only in f"{m.said(ROOT)}"]
    found = [mutant for mutant in found if mutant.key(ROOT) not in known]
    return random.Random(seed).sample(found, min(count, len(found)))


def tried(
    name: str, asked: Mapping[str, Any], copy: Path, tasks: Sequence[tuple[int, Mutant]]
) -> list[tuple[int, str]]:
    """Try mutants in a copy of the checkout; the number of each, and what noticed it or ``""``."""
    shutil.copytree(ROOT, copy, ignore=LEFT_OUT)
    words = [(n, (str(m.file), *astuple(m)[1:])) for n, m in tasks]
    (copy / "mutants.json").write_text(json.dumps({**asked, "mutants": words}), encoding="utf-8")
    command = [sys.executable, "-m", "tests.mutants.worker", name, "mutants.json"]
    own = {"PYTHONPATH": str(copy), "XDG_CACHE_HOME": str(copy / "mutants.cache"), **THREADS}
    found, said = [], {number: mutant.said(ROOT) for number, mutant in tasks}
    with subprocess.Popen(command, cwd=copy, env=os.environ | own, stdout=subprocess.PIPE) as run:
        for line in run.stdout or ():
            event = json.loads(line)
            if "said" in event:
                print(f"{name}: {event['said']}", flush=True)
                continue
            number, failed = event["number"], event["failed"]
            chosen, executing = event["tests"]
            by = f"noticed by {failed}" if failed else f"SURVIVED {chosen} of {executing} tests"
            by = f"compiles to {failed}" if failed == SAME else by
            wall, cpu = event["took"]
            took = f"{cpu:.1f} s of processor time in {wall:.1f} s"
            print(f"{name} {number}: {said[number]}\n    {by}, {took}", flush=True)
            found.append((number, failed))
    if run.returncode:
        raise SystemExit(f"{name}: the worker ended with {run.returncode}")
    return found


def survivors(
    name: str, asked: Mapping[str, Any], mutants: Sequence[Mutant], parallel: int
) -> tuple[list[Mutant], int]:
    """The mutants that nothing noticed, and how many are the same program as before; `parallel` of
    them are tried at a time.
    """
    numbered = list(enumerate(mutants, 1))
    with tempfile.TemporaryDirectory(prefix="mutants-") as scratch:
        with ThreadPoolExecutor(parallel) as pool:
            jobs = [
                pool.submit(tried, name, asked, Path(scratch, str(n)), numbered[n::parallel])
                for n in range(min(parallel, len(numbered)))
            ]
        found = sorted(result for job in jobs for result in job.result())
    alive = [mutants[number - 1] for number, failed in found if not failed]
    return alive, sum(failed == SAME for _, failed in found)


def main() -> int:
    """Make mutants of the groups asked for; 1 where too many survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("groups", nargs="*", default=list(GROUPS), metavar="GROUP")
    parser.add_argument("--count", type=int, default=40, help="mutants of each group (40)")
    parser.add_argument("--seed", type=int, default=1, help="of which are chosen (1)")
    parser.add_argument("--least", type=float, default=0.75, help="share to be noticed (0.75)")
    parser.add_argument("--only", default="", help="only mutants whose line contains this text")
    parser.add_argument("--parallel", type=int, default=1, help="mutants tried at a time (1)")
    parser.add_argument(
        "--budget", type=float, default=20, help="s of processor time of the tests of a mutant (20)"
    )
    parser.add_argument("--tests", nargs="+", help="only these (all of the group)")
    options = parser.parse_args()
    for name in options.groups:
        if name not in GROUPS:
            parser.error(f"unknown group {name!r}; expected one of {', '.join(GROUPS)}")
    few = False
    for name in options.groups:
        mutants = chosen(name, options.count, options.seed, options.only)
        tests = options.tests or GROUPS[name].tests
        asked = {"tests": tests, "budget": options.budget, "checkout": str(ROOT)}
        alive, same = survivors(name, asked, mutants, max(1, options.parallel))
        made = len(mutants) - same
        share = 1 - len(alive) / made if made else 1.0
        few |= share < options.least
        print(f"{name}: {made - len(alive)} of {made} noticed ({share:.0%}), seed {options.seed}")
        if same:
            print(f"    not counted, since they compile to the same program: {same}")
        print("".join(f"    {mutant.said(ROOT)}\n" for mutant in alive), end="", flush=True)
    return 1 if few else 0


if __name__ == "__main__":
    sys.exit(main())
