"""Outcomes that a failing system allows: complete, or one sentence and readable data."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from cosim.links.storage import load_table
from cosim.record import Run, verify
from cosim.record.folder import is_unfinished
from cosim.study.store import rows

#: How the sentence of a command begins.
SENTENCES = ("error: ", "interrupted")
LAST = "last.parquet"


def judge(here: Path, found: Mapping[str, object], whole: Path | None = None) -> None:
    """Raise AssertionError for anything else.

    `here`: what it wrote; `found`: its `code` and what it `said` on standard error; `whole`: the
    same run undisturbed: what is recorded has to be its beginning, or all of it in a run that says
    it is complete. None: it is not known.
    """
    said = [line for line in str(found["said"]).splitlines() if not line.startswith("check: ")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if found["code"] == 0:
            verify(here)
        else:
            assert found["code"] in (1, 2), found
            assert any(line.startswith(SENTENCES) for line in said), found
            assert not any("Traceback" in line for line in said), found
        for folder in recorded_folders(here):
            other = None if whole is None else whole / folder.relative_to(here)
            complete = found["code"] == 0 and not reason(here, folder)
            compared(folder, other, complete=complete)


def reason(here: Path, folder: Path) -> str:
    """The reason of a failed run, which is a row of a complete sweep; "" for any other run."""
    return "" if folder.parent.name != "runs" else str(rows(here)[folder.name]["reason"])


def recorded_folders(here: Path) -> Iterator[Path]:
    """The run folders below a folder in which something was recorded."""
    for folder in (here, *here.glob("runs/*"), here / "offline") if here.exists() else ():
        if (folder / "trajectories.parquet").exists() or readable(folder):
            yield folder


def compared(folder: Path, whole: Path | None, *, complete: bool) -> None:
    """A run folder can be read from t = 0 on, and has what the undisturbed run has."""
    run = Run.open(folder)
    n = len(run)
    assert np.array_equal(run.t, np.arange(n) * 1e-3), f"{folder}: t"
    if (folder / LAST).exists() and not complete:
        last = Run.open(folder / LAST)
        assert not len(last) or last.t[-1] == run.t[-1], f"{folder}: {n} rows, {LAST} has more"
    if whole is None:
        return
    other = Run.open(whole)
    assert n <= len(other) and (n == len(other) or not complete), f"{folder}: {n} rows"
    assert list(run.names) == list(other.names), f"{folder}: columns"
    same = slice(None if complete else max(n - 1, 0))  # the last row is what the last step left
    for name in run.names:
        mine, its = run.column(name)[same], other.column(name)[:n][same]
        assert np.array_equal(mine, its, equal_nan=True), f"{folder}: {name}"
    for link, path in run.link_tables.items():
        held, of_whole = load_table(path)[1], load_table(other.link_tables[link])[1]
        assert np.array_equal(held, of_whole[: len(held)]), f"{folder}: {link}"
        assert len(held) == len(of_whole) or not complete, f"{folder}: {link}"


def readable(folder: Path) -> bool:
    """True if something was recorded that is not closed: a journal without a row is nothing."""
    return is_unfinished(folder) and (folder / "run.json").exists() and recorded(folder)


def recorded(folder: Path) -> bool:
    """True if a node, or the engine, came to its first tick."""
    from bridge.replay import replay
    from cosim.base.errors import CosimError

    if (folder / "trajectories.live").exists():
        return True
    try:
        return bool(replay.load(folder / "nodes"))
    except CosimError:
        return False
