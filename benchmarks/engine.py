"""What a step costs: the engine against a bare C loop, against other masters, and by choice.

    python benchmarks/engine.py [--quick] [--json FILE] [--rounds N]

Everything is measured in one process, in turns; every result is compared with the C loop's.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

import numpy as np

from benchmarks import tables
from benchmarks.bare import Floor
from benchmarks.cases import CHOICES, Case, Choice, rings, standard
from benchmarks.delays import delays
from benchmarks.fmpy_loop import Planned, Ring
from benchmarks.ours import Ours, Recorded
from benchmarks.peers import Ecos, Libcosim
from benchmarks.race import Contestant, Session, race

FLOOR, FLOOR_KEPT = "bare C loop", "bare C loop, recording"
#: Blocks a round of what takes less than a microsecond a tick: many short ones, so that some of
#: them are not interrupted.
BLOCKS = 20


def started(
    master: Callable[..., Session], case: Case, choice: Choice, ticks: int, *options: Any
) -> Session:
    """A master on a plan of its own."""
    return master(case.plan(choice, ticks), *options)


def contestants(case: Case, choice: Choice, check: int, rounds: int) -> list[Contestant]:
    """Who runs a case: the bare loop, the engine, and the others as far as they are there."""
    kept, on = max(case.ticks, check), (case, choice, check + BLOCKS * rounds * case.ticks)
    fast = (1.0, BLOCKS)
    found = [
        Contestant(FLOOR, partial(started, Floor, *on), FLOOR, *fast),
        Contestant("engine", partial(started, Ours, *on), FLOOR, *fast),
        Contestant(FLOOR_KEPT, partial(started, Floor, *on, kept), FLOOR_KEPT, *fast),
        Contestant("engine, recording", partial(started, Ours, *on, kept), FLOOR_KEPT, *fast),
        Contestant("simulate, to Parquet", partial(Recorded, case, choice), FLOOR_KEPT, 24.0),
    ]
    fmpy = Planned if case.name == "teleoperation" else Ring
    peers = (("FMPy", fmpy, 0.1), ("libcosim", Libcosim, 0.2), ("Ecos", Ecos, 0.8))
    for name, master, share in peers:
        plain, recording = (partial(started, master, *on, kept) for kept in (False, True))
        found.append(Contestant(name, plain, FLOOR, share))
        found.append(Contestant(f"{name}, recording", recording, FLOOR_KEPT, share))
    return found


def main_results(scale: float, rounds: int, check: int) -> list[dict[str, Any]]:
    """Every case, in FMI 2.0 and 3.0."""
    results = []
    for case in standard(scale):
        for choice in ("fmi2", "fmi3"):
            say(f"{case.title}, {CHOICES[choice]}")
            ticks = check * 10 if case.name == "teleoperation" else check
            timings = race(
                contestants(case, choice, ticks, rounds),
                ticks=case.ticks, fmu_steps=case.fmu_steps, rounds=rounds, check=ticks,
            )  # fmt: skip
            results.append({
                "case": case.name, "title": case.title, "fmi": choice, "ticks": case.ticks,
                "rows": [t.facts() for t in timings],
            })  # fmt: skip
    return results


def choice_results(scale: float, rounds: int, check: int) -> list[dict[str, Any]]:
    """FMU, C kernel or NumPy, recording: cost, and whether the numbers are the same."""
    teleoperation, wide = standard(scale)[:-3:-1]
    few, many = (max(60, round(scale * n)) for n in (3_600, 900))
    results = []
    for case in (rings(10, few, "10 in a ring"), rings(40, many, "40 in a ring"), wide,
                 teleoperation):  # fmt: skip
        say(f"{case.title}, all choices")
        choices = choice_race(case, rounds, check)
        results.append({"case": case.name, "title": case.title, "choices": choices})
    return results


def choice_race(case: Case, rounds: int, check: int) -> dict[str, Any]:
    """One case with every choice; `difference`: the greatest to FMI 2.0, of all signals."""
    kept = max(case.ticks, check)
    total = check + BLOCKS * rounds * case.ticks
    found = [
        Contestant(
            choice,
            partial(started, Ours, case, choice, total, kept),
            "fmi2",
            *((1.0, BLOCKS) if choice.startswith("fmi") else (0.08, 1)),
        )
        for choice in CHOICES
    ]
    timings = race(found, ticks=case.ticks, fmu_steps=case.fmu_steps, rounds=rounds, check=check)
    choices = {t.label: t.facts() for t in timings}
    rows = {choice: trajectory(case, choice, check) for choice in CHOICES}
    for choice in CHOICES:
        choices[choice]["difference"] = float(np.abs(rows[choice] - rows["fmi2"]).max())
    return choices


def trajectory(case: Case, choice: Choice, ticks: int) -> Any:
    """All signals at the first `ticks` ticks, (ticks, n)."""
    session = Ours(case.plan(choice, ticks), ticks)
    session.run(ticks)
    session.close()
    return session.rows


def say(text: str) -> None:
    """Tell somebody who waits."""
    print(text, file=sys.stderr, flush=True)


def report(found: dict[str, Any]) -> str:
    """The tables of a run."""
    parts = []
    for fmi in ("fmi2", "fmi3"):
        parts += [f"### {CHOICES[fmi]}: best (median), ratio of the best to the bare C loop's"]
        parts += [tables.main_table(found["cases"], fmi)]
    parts += ["### What a component is, engine recording: best (median), `=` same bytes"]
    parts += [tables.choice_table(found["choices"])]
    parts += ["### Time-varying delays on every connection"]
    parts += [tables.delay_table(found["delays"])]
    return "\n\n".join(parts)


def main() -> None:
    """Measure, print the tables, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a few steps of everything")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--rounds", type=int, default=7, help="rounds of blocks (default 7)")
    options = parser.parse_args()
    scale, rounds, check = (0.01, 1, 40) if options.quick else (1.0, options.rounds, 300)
    before = tables.machine()
    found = {
        "machine": before,
        "cases": main_results(scale, rounds, check),
        "choices": choice_results(scale, rounds, check),
        "delays": delays(max(60, round(3_000 * scale)), BLOCKS, rounds, check),
        "load after": tables.machine()["load"],
    }
    print(report(found))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
