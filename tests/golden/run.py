"""All cases, run in processes, compared with the file of digests or written to it."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.golden import offline, twins
from tests.golden.kept import ROOT, Kept, Record, differences

#: Folders whose last commit the file names: what digests depend on.
MADE_OF = ("bridge", "cosim", "fmus", "configs")
FILE = Path(__file__).with_name("digests.json")
CASES: Mapping[str, Callable[[Record], None]] = {
    "paper": offline.paper,
    **twins.CASES,
    **{f"run {n}": partial(offline.scenario, name=n) for n in offline.SCENARIOS},
    **{f"run {n}": partial(offline.variant, name=n) for n in offline.VARIANTS},
    "export": offline.export,
    "sweep": offline.study,
    "compare": offline.comparison,
    "fmus": offline.fmus,
    "help": offline.helps,
    "refusals": offline.refusals,
    "scaffold": offline.scaffold,
}


def case(name: str, texts: Path | None = None) -> dict[str, Kept]:
    """The results of one case; the texts behind its digests go into `texts`, if given."""
    with TemporaryDirectory(prefix="golden") as folder:
        record = Record(Path(folder))
        CASES[name](record)
    for label, text in record.texts.items() if texts else ():
        target = texts / f"{name} {label}".replace("/", "_")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text + "\n", encoding="utf-8")
    return record.kept


def results(names: Sequence[str], jobs: int, texts: Path | None) -> dict[str, dict[str, Kept]]:
    """The results of all cases; of a case that failed, the reason."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=spawn) as pool:
        return dict(zip(names, pool.map(partial(_guarded, texts=texts), names), strict=True))


def _guarded(name: str, texts: Path | None) -> dict[str, Kept]:
    try:
        return case(name, texts)
    except Exception:  # told by the line of the case
        return {"failed": traceback.format_exc()}


def frozen() -> dict[str, dict[str, Kept]]:
    """The cases in the file."""
    return dict(json.loads(FILE.read_text(encoding="utf-8"))["cases"])


def compared(names: Sequence[str], jobs: int, texts: Path | None = None) -> list[str]:
    """A line for every difference."""
    was = frozen()
    found = results(names, jobs, texts)
    return [
        f"{name}: {line}" for name in names for line in differences(was.get(name, {}), found[name])
    ]


def written(names: Sequence[str], jobs: int, texts: Path | None = None) -> str:
    """Freeze these cases, keep the others, and those that fail as they were."""
    every = results(names, jobs, texts)
    found = {name: kept for name, kept in every.items() if "failed" not in kept}
    failed = [f"{name}: {every[name]['failed']}" for name in names if name not in found]
    cases = (frozen() if FILE.exists() else {}) | found
    commit = _git("log", "-1", "--format=%H %cs", "--", *MADE_OF)
    document = {"commit": commit, "cases": {name: cases[name] for name in CASES if name in cases}}
    FILE.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return "\n".join([*failed, f"{len(found)} cases of {len(cases)} frozen at {commit}: {FILE}"])


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()
