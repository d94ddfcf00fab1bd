"""``python -m tests.drive_faults --runs 1000``: the campaign, its table, and all seeds.

A run is made by its seed alone; those that the file of results has are not made again. The exit
status is 1 if a run was not as it has to be.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cosim.base.clock import stopwatch
from cosim.cli.show import aligned
from tests.drive_faults import lives

Record = Mapping[str, Any]


def main(arguments: Sequence[str]) -> int:
    """Make the runs that are missing, and print the table of all."""
    parser = argparse.ArgumentParser(prog="python -m tests.drive_faults", description=__doc__)
    parser.add_argument(
        "--runs", type=int, default=1000, help="number of runs, each with one fault"
    )
    parser.add_argument("--first", type=int, default=0, help="seed of the first run")
    parser.add_argument("--out", type=Path, default=Path("runs/drive-faults.jsonl"))
    given = parser.parse_args(arguments)
    seeds = range(given.first, given.first + given.runs)
    records = [r for r in _made(given.out, seeds)]
    print("\n".join(aligned(table(records))))
    print(f"seeds            {seeds.start} to {seeds.stop - 1}, each drawn by its own generator")
    print(f"results          {given.out}")
    wrong = [r for r in records if r["problems"]]
    for record in wrong:
        print(f"seed {record['seed']} ({named(record)}): {'; '.join(record['problems'])}")
    return 1 if wrong else 0


def named(record: Record) -> str:
    """The fault of a run, for people."""
    code = f" {record['code']:#x}" if record["code"] else ""
    lasts = f" for {record['lasts']:g} s" if record["lasts"] is not None else ""
    what = f"{record['does']}{code} at {record['at']:g} s{lasts}"
    return f"{record['deployment']}, {record['drive']}: {what}, {record['phase']}"


def _made(path: Path, seeds: Sequence[int]) -> Iterator[Record]:
    """The records of these seeds, in their order: of the file, or made now and appended to it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    known = {record["seed"]: record for record in map(json.loads, lines)}
    with path.open("a", encoding="utf-8") as file:
        for seed in seeds:
            if seed not in known:
                watch = stopwatch()
                with TemporaryDirectory() as folder:
                    known[seed] = lives.run(seed, Path(folder)).facts() | {"wall": watch()}
                file.write(json.dumps(known[seed]) + "\n")
                file.flush()
            yield known[seed]


def table(records: Sequence[Record]) -> list[list[str]]:
    """A row for each kind of drive, and one for all."""
    head = ["drives", "runs", "torques", "to a drive that told it was off", "before it could tell"]
    rows = [[*head, "off in the run", "of these passed", "latest stop", "replays exact"]]
    kinds = sorted({record["deployment"] for record in records})
    for kind in [*kinds, "all"]:
        mine = [r for r in records if kind in ("all", r["deployment"])]
        off = [r for r in mine if r["off"] > 0]
        stops = [r["stopped"] for r in mine if r["stopped"] is not None]
        rows.append(
            [
                kind,
                str(len(mine)),
                str(sum(r["torques"] for r in mine)),
                str(sum(r["forbidden"] for r in mine)),
                f"{sum(r['unheard'] for r in mine)}, at most {max(r['unheard'] for r in mine)}",
                str(len(off)),
                str(sum(r["verdict"] == "passed" for r in off)),
                f"{max(stops, default=0.0) * 1e3:.1f} ms",
                f"{sum(r['exact'] for r in mine)} of {len(mine)}",
            ]
        )
    return rows


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
