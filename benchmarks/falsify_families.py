"""Runs until ``cosim falsify`` finds a failure: each family of candidates alone, over seeds.

    python benchmarks/falsify_families.py [--quick] [--seeds N] [--runs N] [--jobs N] [--json FILE]

The scenarios are those of `falsify_cases.py`. *plain draws* are the delays that the links' own law
draws, as runs with other seeds of the scenario have them. *optimizer, 0 or 1* is the optimizer
without the margin: it gets the same score for each run that passes. *all* is the product: all
families in their order, with their shares of the runs. A family that comes to an end before its
runs are used up begins a new pass. Counted is the first run that fails, the nominal one not.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: threads of BLAS would be measured

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from benchmarks.falsify_cases import Document, settling, stiff, waves
from cosim.falsify.evaluation import Problem, run_candidates
from cosim.falsify.families import Space
from cosim.falsify.judge import CandidateOutcome
from cosim.falsify.optimizer import optimizer
from cosim.falsify.paths import Candidate, DelayPath
from cosim.falsify.problem import problem_of
from cosim.falsify.scenario_text import text
from cosim.falsify.search import FAMILIES, Account, Budget, Outcomes, Rounds, drawn, search
from cosim.links.laws import decimal_fraction

#: Scenarios, and what they have to do.
CASES: dict[str, Callable[[], Document]] = {
    "(a) stiff hand: near": stiff,
    "(b) README's hand: settled by 14 s": settling,
    "(c) wave: offset ≤ 3.2 rad": waves,
    "(d) wave: offset ≤ 5.5 rad": partial(waves, offset=5.5),
}
Evaluation = Callable[[list[Candidate]], list[CandidateOutcome]]


def plain(space: Space, turn: int) -> Iterator[Candidate]:
    """Delays as the law of each channel draws them."""
    random = space.random("plain", turn)
    while True:
        paths = []
        for c in space.channels:
            stream = c.laws[0].stream(c.step * decimal_fraction(c.h), random)
            paths.append(DelayPath.sampled(stream.take(-(-space.ticks // c.step)), c.step))
        yield space.candidate(paths, "plain draws")


def flat(space: Space, turn: int, share: int) -> Rounds:
    """The optimizer without the margin."""
    rounds = optimizer(space, turn, share)
    some = next(rounds)
    while True:
        yield some
        try:
            some = rounds.send([0.0] * len(some))
        except StopIteration:
            return


MEASURED = {
    "plain draws": (drawn(plain), 1.0), **FAMILIES, "optimizer, 0 or 1": (flat, 1.0)
}  # fmt: skip
#: The rows of the table: names, and the families of each.
METHODS = {name: (name,) for name in MEASURED} | {"all": tuple(FAMILIES)}


def first_failures(searches: Sequence[Outcomes], evaluate: Evaluation) -> list[int | None]:
    """The number of the first run of each search that fails, 0: the nominal one; None: there is
    none.

    All searches advance together, so that `evaluate` gets many candidates.
    """
    found: list[int | None] = [None] * len(searches)
    done = [-1] * len(searches)
    waiting = {i: next(search) for i, search in enumerate(searches)}
    while waiting:
        results = iter(evaluate([c for some in waiting.values() for c in some]))
        for i, some in list(waiting.items()):
            outcomes = list(islice(results, len(some)))
            failing = [k for k, outcome in enumerate(outcomes) if outcome.fails()]
            del waiting[i]
            if failing:
                found[i] = done[i] + 1 + failing[0]
                continue
            done[i] += len(some)
            with suppress(StopIteration):
                waiting[i] = searches[i].send(outcomes)
    return found


def failures_within(
    problem: Problem, seeds: int, evaluate: Evaluation, families: Sequence[str], runs: int
) -> list[int | None]:
    """The first run that fails among the first `runs` with each seed, None: there is none."""
    searches = []
    for seed in range(seeds):
        account = Account()
        over = partial(_used, account, runs)
        budget = Budget(runs, len(families) == 1, tuple(families), over, seed)
        searches.append(search(Space(problem, seed), budget, account, MEASURED))
    found = first_failures(searches, evaluate)
    return [x if x is None or x <= runs else None for x in found]


def _used(account: Account, runs: int) -> bool:
    return account.total > runs


def measured(case: str, method: str, seeds: int, runs: int) -> dict[str, Any]:
    """The first failures of a method for all seeds, and its processor time, s."""
    before = process_time()
    with tempfile.TemporaryDirectory(prefix="falsify-") as folder:
        path = Path(folder, "case.toml")
        path.write_text(text(CASES[case]()), encoding="utf-8")
        problem, _ = problem_of(path)
        evaluate = partial(run_candidates, problem)
        found = failures_within(problem, seeds, evaluate, METHODS[method], runs)
    return {"case": case, "method": method, "first": found, "seconds": process_time() - before}


def cell(first: Sequence[int | None], runs: int) -> str:
    """The median number of runs, and how many seeds found one."""
    middle = float(np.median([np.inf if x is None else x for x in first]))
    found = sum(x is not None for x in first)
    if not found:
        return f"— (0 of {len(first)})"
    return f"{f'> {runs}' if middle > runs else f'{middle:g}'} ({found} of {len(first)})"


def arguments(description: str | None, runs: int) -> argparse.ArgumentParser:
    """The options of a benchmark of many seeds, each with so many `runs`."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one seed, few runs")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--runs", type=int, default=runs)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    return parser


def all_measured(
    options: argparse.Namespace,
    quick: int,
    measure: Callable[[str, str, int, int], dict[str, Any]],
    tasks: Iterable[tuple[str, str]],
) -> list[dict[str, Any]]:
    """The results of all tasks, computed by several processes, and written as JSON if wanted.

    `quick`: runs of the one seed of a quick measurement.
    """
    if options.quick:
        options.seeds, options.runs = 1, quick
    with ProcessPoolExecutor(options.jobs) as pool:
        waiting = [pool.submit(measure, *t, options.seeds, options.runs) for t in tasks]
        found = [one.result() for one in waiting]
    if options.json:
        facts = {"machine": tables.machine(), "runs": options.runs, "found": found}
        options.json.write_text(json.dumps(facts, indent=1), encoding="utf-8")
    return found


def main() -> None:
    """Measure, and print the table."""
    options = arguments(__doc__, 1000).parse_args()
    tasks = [(case, method) for method in METHODS for case in CASES]
    found = all_measured(options, 40, measured, tasks)
    cells = {(x["case"], x["method"]): cell(x["first"], options.runs) for x in found}
    rows = [[method, *(cells[case, method] for case in CASES)] for method in METHODS]
    seconds = sum(x["seconds"] for x in found)
    print(tables.grid(["candidates", *CASES], rows))
    print(f"\n{options.seeds} seeds, {options.runs} runs; {seconds:.0f} s of processor time")


if __name__ == "__main__":
    main()
