"""What a command may do where the system fails it: complete, or one sentence and readable data."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cosim.record import Run, verify
from cosim.record.recover import unfinished

#: How the sentence of a command begins.
SENTENCES = ("error: ", "interrupted")


def judge(here: Path, found: Mapping[str, object], rows: int | None = None) -> None:
    """Raise AssertionError for anything else.

    `here`: what it wrote; `found`: its `code` and what it `said` on standard error; `rows`: of a
    run that is complete, None: any.
    """
    said = [line for line in str(found["said"]).splitlines() if not line.startswith("check: ")]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if found["code"] == 0:
            verify(here)
            assert rows is None or len(Run.open(here)) == rows
            return
        assert found["code"] in (1, 2), found
        assert any(line.startswith(SENTENCES) for line in said), found
        assert not any("Traceback" in line for line in said), found
        for folder in (here, *here.glob("runs/*")) if here.exists() else ():
            if (folder / "trajectories.parquet").exists() or readable(folder):
                run = Run.open(folder)
                assert np.array_equal(run.t, np.arange(len(run)) * 1e-3)


def readable(folder: Path) -> bool:
    """Whether something was recorded that is not closed: a journal without a row is nothing."""
    return unfinished(folder) and (folder / "run.json").exists() and recorded(folder)


def recorded(folder: Path) -> bool:
    """Whether a node, or the engine, came to its first tick."""
    from bridge.replay import replay
    from cosim.base.errors import CosimError

    if (folder / "trajectories.live").exists():
        return True
    try:
        return bool(replay.load(folder / "nodes"))
    except CosimError:
        return False
