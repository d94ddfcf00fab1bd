"""The engine compared with all other available masters: a step, the start, and memory.

    python benchmarks/others.py [--quick] [--json FILE] [--rounds N]

Each master has a separate process and runs in turn; one that fails or takes too long is listed with
the reason.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1]))  # an installed cosim comes first

from benchmarks import tables
from benchmarks.apart import Apart
from benchmarks.cases import CHOICES, Case, Choice
from benchmarks.entrants import ENTRANTS, Entrant, peer_cases
from benchmarks.peers import Absent, units
from benchmarks.race import Contestant, race

ENGINE = "engine"
VERSIONS: tuple[Choice, ...] = ("fmi2", "fmi3")


def contestants(case: Case, choice: Choice, check: int, blocks: int) -> list[Contestant]:
    """Everybody without and with recording, each in a process apart, next to the engine."""
    found = []
    for recorded, suffix in ((False, ""), (True, ", recording")):
        for e in ENTRANTS:
            if recorded and not e.records:
                continue
            request = {
                "entrant": e.name, "case": case.name, "fmi": choice, "recorded": recorded,
                "ticks": max(case.ticks, check),
            }  # fmt: skip
            some = _blocks(e, blocks)
            make = partial(Apart, request)
            found.append(Contestant(e.name + suffix, make, ENGINE + suffix, e.share, some))
    return found


def _blocks(e: Entrant, blocks: int) -> int:
    """Many short blocks of what is quick."""
    return blocks if e.share == 1.0 else max(1, round(blocks / 4)) if e.share > 0.1 else 1


def races(scale: float, rounds: int, check: int, blocks: int) -> list[dict[str, Any]]:
    """Every case in both versions of FMI."""
    results = []
    for case in peer_cases(scale):
        for choice in VERSIONS:
            say(f"{case.title}, {CHOICES[choice]}")
            case.plan(choice, 1)  # builds its FMU, so that nobody has to
            timings = race(
                contestants(case, choice, check, blocks),
                ticks=case.ticks, fmu_steps=case.fmu_steps, rounds=rounds, check=check,
            )  # fmt: skip
            results.append({
                "case": case.name, "title": case.title, "fmi": choice, "ticks": case.ticks,
                "rows": [t.facts() for t in timings], "load": os.getloadavg()[0],
            })  # fmt: skip
    return results


def distinct(case: Case, choice: Choice, folder: Path) -> list[str]:
    """The FMUs of a case as files of which no two have the same content."""
    paths = []
    for i, unit in enumerate(units(case.plan(choice, 1))):
        path = folder / f"fmu{i:02}.fmu"
        path.write_bytes(unit.path.read_bytes())
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("documentation/copy.txt", f"copy {i}\n")
        paths.append(str(path))
    return paths


def startups(runs: int) -> dict[str, dict[str, Any]]:
    """Seconds to the first step of 12 FMUs, from new processes; the first of each fills caches."""
    found: dict[str, dict[str, Any]] = {e.name: {"all": []} for e in ENTRANTS if e.records}
    case = peer_cases(1.0)[2]
    with tempfile.TemporaryDirectory(prefix="start-") as folder:
        paths = distinct(case, "fmi2", Path(folder))
        for turn in range(runs + 1):
            for name, row in found.items():
                request = {"entrant": name, "case": case.name, "fmi": "fmi2", "paths": paths}
                try:
                    process = Apart(request, limit=60.0)
                except Absent as absent:
                    row["absent"] = str(absent)
                    continue
                process.close()
                if turn:
                    row["all"].append(process.facts["seconds"])
                    if process.facts["seconds"] == min(row["all"]):
                        row |= process.facts
    for row in found.values():
        if row["all"]:
            row |= {"min": min(row["all"]), "median": median(row["all"])}
    return found


def memories(ticks: int) -> dict[str, dict[str, Any]]:
    """Peak MB of a process that runs 12 FMUs and records `ticks` ticks."""
    found: dict[str, dict[str, Any]] = {}
    for name in ("", *(e.name for e in ENTRANTS if e.records)):
        request = {"entrant": name, "case": "ring12", "fmi": "fmi2", "recorded": True}
        try:
            process = Apart({**request, "ticks": ticks}, limit=60.0)
            if name:
                process.run(ticks)
            found[name or "nobody"] = {"peak_mb": process.memory()}
            process.close()
        except Absent as absent:
            found[name or "nobody"] = {"absent": str(absent)}
    return found


def imports(runs: int) -> list[float]:
    """Seconds to import what a run needs, each in a new process."""
    code = (
        "import time; t = time.perf_counter(); import cosim.scenario.assemble, "
        "cosim.engine.engine, "
        "cosim.scenario.spec; print(time.perf_counter() - t)"
    )
    path = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": path}
    command = [sys.executable, "-c", code]
    return [
        float(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)
        for _ in range(runs)
    ]


def goals(cases: list[dict[str, Any]]) -> str:
    """The quickest peer of every case: how many times the engine's cost it has."""
    rows = []
    for found in cases:
        cells = [f"{found['title']}, {CHOICES[found['fmi']][5:]}"]
        for recording in (False, True):
            peers = [
                (row["ratio_min"], row["runner"].removesuffix(", recording"))
                for row in found["rows"]
                if "ratio_min" in row
                and row["runner"].endswith(", recording") is recording
                and row["runner"].partition(",")[0] != ENGINE
            ]
            own = [p for p in peers if not p[1].endswith(("one call", "in the engine"))]
            cells += [_best(own), _best(peers)]
        rows.append(cells)
    header = ["the quickest", "its own loop", "any way", "its own loop, recording"]
    header.append("any way, recording")
    return tables.grid(header, rows)


def _best(peers: list[tuple[float, str]]) -> str:
    ratio, name = min(peers, default=(float("nan"), "nobody"))
    return f"{name}: {ratio:.3g}×"


def report(found: dict[str, Any]) -> str:
    """The tables of a run."""
    parts = []
    for fmi in VERSIONS:
        parts += [f"### {CHOICES[fmi]}: best (median), ratio of the best to the engine's"]
        parts += [tables.main_table(found["cases"], fmi)]
    parts += ["### How many times the engine's cost", goals(found["cases"])]
    parts += ["### To the first step of 12 FMUs, and memory"]
    rows = [["nobody", "", "", f"{found['memory']['nobody']['peak_mb']:.1f}"]]
    for name, row in found["startup"].items():
        memory = found["memory"][name]
        times = [f"{row[k] * 1e3:.1f}" for k in ("min", "median")] if row["all"] else ["", ""]
        peak = f"{memory['peak_mb']:.1f}" if "peak_mb" in memory else memory["absent"]
        rows.append([name, *times, peak])
    parts += [tables.grid(["", "best ms", "median ms", "peak MB"], rows)]
    stages = ", ".join(f"{k} {v * 1e3:.1f}" for k, v in found["startup"][ENGINE]["stages"].items())
    parts += [f"Engine, ms: {stages}; imports before that {min(found['imports']) * 1e3:.0f}."]
    return "\n\n".join(parts)


def say(text: str) -> None:
    """Tell somebody who waits."""
    print(text, file=sys.stderr, flush=True)


def main() -> None:
    """Measure, print the tables, write the numbers."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a few steps of everything")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers here")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of blocks (default 5)")
    options = parser.parse_args()
    quick = options.quick
    scale, rounds, check, blocks = (0.01, 1, 40, 1) if quick else (1.0, options.rounds, 200, 12)
    found = {
        "machine": tables.machine(),
        "cases": races(scale, rounds, check, blocks),
        "startup": startups(1 if quick else options.rounds),
        "memory": memories(50 if quick else 1000),
        "imports": imports(1 if quick else options.rounds),
        "load after": os.getloadavg(),
    }
    print(report(found))
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
