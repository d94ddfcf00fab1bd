"""Runs with more signals than are all kept: what is recorded is the same, and nothing else is."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import Interrupted, RunError
from cosim.engine import binding
from cosim.engine import simulate as simulation
from cosim.engine.engine import Engine
from cosim.engine.simulate import Execution, simulate
from cosim.loading.files import load
from cosim.record import Recorder, Run
from cosim.record.folder import LAST, LIVE, METADATA, PART
from cosim.record.recover import complete
from cosim.scenario.spec import Scenario
from tests.bridge.zenoh.rehearsed import CONFIGS

NAMES = "trajectories.parquet"


def made(*changes: str) -> Scenario:
    """25 robots; every 7th tick is recorded, which 2.5 s are no multiple of."""
    return load(CONFIGS / "many.toml", ("run.stop=2.5", "run.record.every=7", *changes))


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "EVERYTHING", 10)


@pytest.mark.parametrize("every", [1, 7, 3000])
@pytest.mark.parametrize("threads", [1, 2])
def test_what_is_recorded_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, every: int, threads: int
) -> None:
    scenario = made(f"run.record.every={every}")
    simulate(scenario, tmp_path / "all")
    monkeypatch.setattr(simulation, "EVERYTHING", 10)
    monkeypatch.setattr(binding, "LEAST", 2)
    assert simulate(scenario, tmp_path / "some", execution=Execution(threads)).shared == (
        threads > 1
    )
    assert (tmp_path / "some" / NAMES).read_bytes() == (tmp_path / "all" / NAMES).read_bytes()


def grid_of(run: Run, upto: float) -> None:
    """Only rows on the grid, all of them up to a time (s)."""
    assert np.array_equal(np.rint(run.t * 1000).astype(int), np.arange(0, round(upto * 1000), 7))
    assert all(np.isfinite(run.column(name)).all() for name in run.names)


@pytest.mark.usefixtures("few")
def test_a_run_that_is_interrupted_or_fails_ends_with_a_row_that_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = simulate(made(), tmp_path / "whole")
    ticks = iter([400, 400])
    real = Engine.run

    def stops(self: Engine, n: int, *how: object) -> int:
        n = min(n, next(ticks, 0))
        return real(self, n, *how)  # type: ignore[arg-type]

    monkeypatch.setattr(simulation, "CHUNK_VALUES", 1000 * 52)
    with monkeypatch.context() as patch:
        patch.setattr(Engine, "run", stops)
        with pytest.raises(Interrupted):
            simulate(made(), tmp_path / "cut")
    cut = Run.open(tmp_path / "cut")
    grid_of(cut, 0.4)
    with pytest.raises(RunError, match="at tick"):
        simulate(made("components.robot.parameters.k_p=1e9"), tmp_path / "failed")
    failed, last = (Run.open(tmp_path / "failed" / name) for name in (NAMES, LAST))
    grid_of(failed, failed.t[-1] + 1e-3)
    assert np.array_equal(last.t, failed.t[-len(last) :]) and list(last.names) == list(failed.names)
    reference = Run.open(whole.folder)
    for name in cut.names:
        assert np.array_equal(cut.column(name), reference.column(name)[: len(cut)])


@pytest.mark.usefixtures("few")
def test_a_killed_run_is_recovered_without_rows_that_were_not_filled_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files of a run as they are before its end, with rows of noise in the buffers."""
    buffer = Recorder.buffer

    def noisy(self: Recorder) -> np.ndarray:
        rows = buffer(self)
        rows[:] = 77.0
        return rows

    copied = tmp_path / "killed"

    def copy(done: int, _: int) -> None:
        if done < 2500 and not copied.exists():
            copied.mkdir()
            for name in (LIVE, PART, METADATA):
                shutil.copy(tmp_path / "run" / name, copied / name)

    monkeypatch.setattr(Recorder, "buffer", noisy)
    monkeypatch.setattr(simulation, "CHUNK_VALUES", 1000 * 52)
    simulate(made(), tmp_path / "run", copy)
    complete(copied)
    run = Run.open(copied)
    reference = Run.open(tmp_path / "run")
    assert 0 < len(run) < len(reference)
    for name in run.names:
        assert np.array_equal(run.column(name), reference.column(name)[: len(run)])
    last = Run.open(copied / LAST)
    assert set(np.rint(last.t * 1000).astype(int) % 7) == {0}
