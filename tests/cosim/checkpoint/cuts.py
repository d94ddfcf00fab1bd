"""Runs that are cut at random ticks and resumed, beside one without interruption.

A folder that is copied during the run is what a process leaves that is killed at that moment.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from cosim.checkpoint import CheckpointInterval, CheckpointKeeper, Resumption
from cosim.engine.simulate import Execution, simulate
from cosim.record.folder import CHECKPOINTS
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build

#: Ticks in a chunk of these runs, between two of which a checkpoint can be.
CHUNK = 64

Make = Callable[[], Scenario]


def contents(folder: Path) -> dict[str, bytes]:
    """The files of a finished run; of ``run.json`` what is not wall time."""
    found = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    facts = json.loads(found.pop("run.json"))
    del found["SHA256SUMS"]  # has the sum of run.json
    assert facts.pop("wall") > 0
    return {**found, "run.json": json.dumps(facts).encode()}


def kept(folder: Path, scenario: Scenario, copies: dict[int, Path], threads: int = 1) -> None:
    """A run with a checkpoint at every chunk, whose folder is copied at some ticks."""
    left = sorted(copies)

    def copy(done: int, _: int) -> None:
        while left and done >= left[0]:
            shutil.copytree(folder, copies[left.pop(0)])

    keeper = CheckpointKeeper(CheckpointInterval(0.0), {})
    simulate(scenario, folder, copy, execution=Execution(threads, keeper))
    keeper.end()
    assert not left and not (folder / CHECKPOINTS).exists()


def resumed(folder: Path, scenario: Scenario, threads: int = 1, interval: float = 1e9) -> int:
    """Resume a run to its end; the tick from which on."""
    found = Resumption.open(folder)
    keeper = CheckpointKeeper(CheckpointInterval(interval), {}, found)
    simulate(scenario, folder, execution=Execution(threads, keeper))
    keeper.end()
    return found.tick


def same_after_cuts(folder: Path, make: Make, threads: int = 1, cuts: int = 3) -> None:
    """Compare a run with those resumed from copies at random ticks."""
    scenario = make()
    ticks = assemble(scenario).ticks
    simulate(scenario, folder / "whole", execution=Execution(threads))
    whole = contents(folder / "whole")
    at = Random(folder.name).sample(range(CHUNK, ticks - CHUNK), cuts)
    copies = {tick: folder / f"cut-{tick}" for tick in at}
    kept(folder / "kept", make(), copies, threads)
    assert contents(folder / "kept") == whole
    for tick, path in copies.items():
        start = resumed(path, make(), threads)
        assert tick - CHUNK <= start <= tick + CHUNK
        assert contents(path) == whole


def built(folder: Path, document: dict[str, Any]) -> Make:
    """A scenario of a document, anew for each run."""
    return lambda: build(document, folder / "s.toml")
