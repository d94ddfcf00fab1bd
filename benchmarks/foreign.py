"""The cost of a step of FMUs of other tools: the engine against a bare C loop over the same calls.

    python benchmarks/foreign.py [FMU...] [--quick] [--json FILE] [--rounds N]

The FMUs of ``engine.py`` with their values closed, as those of other tools have them, so that both
sides call them through FMI only; and the FMU files that are named, one and four of each without
connections, which may have numbers (Real, Float64) only. In turns and compared as in ``engine.py``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))

from benchmarks import tables
from benchmarks.bare import Floor
from benchmarks.cases import CHOICES, TELEOPERATION, standard
from benchmarks.engine import BLOCKS, FLOOR, FLOOR_KEPT
from benchmarks.ours import Ours
from benchmarks.race import Contestant, Session, race
from cosim.fmi import FmuComponent
from cosim.fmi.alike import CommonInstance
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan

#: FMUs of a file that are stepped in one plan.
COUNTS = (1, 4)
STEP = 1 / 128


def close_values() -> None:
    """Let no FMU have open values: the engine then calls our own FMUs as it does others."""
    CommonInstance.values_address = lambda self: 0  # type: ignore[method-assign]


def several(path: Path, count: int, ticks: int) -> Plan:
    """A plan of `count` instances of an FMU file."""
    components = {f"f{i}": {"model": str(path.resolve())} for i in range(count)}
    document = {"run": {"step": STEP, "stop": ticks * STEP}, "components": components}
    return assemble(build(document, TELEOPERATION.parent / f"{path.stem}.toml"))


def reports(plan: Plan) -> bool:
    """True if an FMU of the plan reports events, or steps that end early."""
    fmus = (s.component for s in plan.components)
    return any(isinstance(x, FmuComponent) and (x.events or x.returns_early) for x in fmus)


def measured(plan: Callable[[], Plan], ticks: int, steps: float, rounds: int) -> list[Any]:
    """Rows of a table: the bare loop and the engine, without and with recording.

    If FMUs report events or early returns, the loop handles them, as FMI 3.0 demands of an
    importer; one more ignores them.
    """
    events = reports(plan())

    def started(master: Callable[..., Session], *options: Any) -> Session:
        return master(plan(), *options)

    contestants = []
    for floor, label, kept in ((FLOOR, "engine", ()), (FLOOR_KEPT, "engine, recording", (ticks,))):
        rows = [(floor, Floor), (label, Ours)]
        if events:
            rows[0] = (floor, partial(Floor, events=True))
            rows.insert(1, (f"{floor}, ignoring events", Floor))
        contestants += [
            Contestant(name, partial(started, master, *kept), floor, 1.0, BLOCKS)
            for name, master in rows
        ]
    found = race(contestants, ticks=ticks, fmu_steps=steps, rounds=rounds, check=min(60, ticks))
    return [t.facts() for t in found]


def results(files: list[Path], scale: float, rounds: int) -> list[dict[str, Any]]:
    """All cases in both versions, then the files, each with its number of instances."""
    found = []
    for case in standard(scale):
        for choice in ("fmi2", "fmi3"):
            length = 60 + (BLOCKS * rounds + 1) * case.ticks
            rows = measured(partial(case.plan, choice, length), case.ticks, case.fmu_steps, rounds)
            found.append({"case": case.name, "title": case.title, "fmi": choice, "rows": rows})
    for path in files:
        for count in COUNTS:
            ticks = max(60, round(scale * 10_000 / count))
            length = 60 + (BLOCKS * rounds + 1) * ticks
            rows = measured(partial(several, path, count, length), ticks, count, rounds)
            title = f"{path.stem}, {count}"
            found.append({"case": title, "title": title, "fmi": "file", "rows": rows})
    return found


def main() -> None:
    """Measure, print the tables, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("files", type=Path, nargs="*", metavar="FMU")
    parser.add_argument("--quick", action="store_true", help="a few steps of everything")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--rounds", type=int, default=7, help="rounds of blocks (default 7)")
    options = parser.parse_args()
    close_values()
    machine = tables.machine()
    found = results(options.files, *((0.01, 1) if options.quick else (1.0, options.rounds)))
    for fmi in ("fmi2", "fmi3", "file"):
        if any(r["fmi"] == fmi for r in found):
            title = CHOICES.get(fmi, "FMU files, instances")  # type: ignore[call-overload]
            print(f"### {title}\n\n{tables.main_table(found, fmi)}\n")
    if options.json:
        text = json.dumps({"machine": machine, "cases": found}, indent=1)
        options.json.write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
