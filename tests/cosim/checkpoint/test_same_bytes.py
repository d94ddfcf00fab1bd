"""A run that is resumed from a checkpoint: the same bytes as without interruption."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from cosim.checkpoint import CheckpointInterval, CheckpointKeeper, Resumption
from cosim.engine import simulate as simulation
from cosim.engine.simulate import Execution, simulate
from cosim.loading.files import load
from cosim.record import groups
from cosim.scenario.spec import Scenario
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.checkpoint.cuts import built, contents, kept, resumed, same_after_cuts

MODEL = "tests.cosim.checkpoint.blocks"


CASES = {
    "teleoperation": ("teleoperation.toml", "run.stop=3"),
    "teleoperation 3.0": ("teleoperation.toml", "run.stop=3", "run.seed=7",
                          *(f"components.{x}.fmi='3.0'" for x in ("master", "slave"))),
    "loss": ("teleoperation.toml", "run.stop=3", "run.seed=3", "run.record.every=7",
             'links.0.loss={law="gilbert-elliott", p=0.05, r=0.3}',
             'links.0.semantics="newest-stamp"'),
    "network": ("network.toml", "run.stop=4"),
    "many": ("many.toml", "run.stop=2.5"),
    "six_axis": ("six_axis.toml", "run.stop=2"),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_configs(tmp_path: Path, name: str) -> None:
    file, *settings = CASES[name]
    same_after_cuts(tmp_path, lambda: load(CONFIGS / file, settings))


def test_the_larger_row_groups_of_a_long_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit, rows in (("_GROUP_LEAST", 8), ("_GROUP_MOST", 64), ("_MANY", 8)):
        monkeypatch.setattr(groups, limit, rows)
    file, *settings = CASES["teleoperation"]
    same_after_cuts(tmp_path, lambda: load(CONFIGS / file, settings))
    found = pq.ParquetFile(tmp_path / "whole" / "trajectories.parquet").metadata
    assert found.row_group(0).num_rows == 512


@pytest.mark.parametrize("threads", [1, 2])
def test_parts_of_a_plan_that_threads_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    monkeypatch.setattr("cosim.engine.binding.LEAST", 2)
    monkeypatch.setattr("cosim.engine.binding.ALONE", 2)
    monkeypatch.setattr(simulation, "EVERYTHING", 10)
    settings = ("graphs.net.n=40", "run.stop=1", "run.record.every=3")
    same_after_cuts(tmp_path, lambda: load(CONFIGS / "many.toml", settings), threads)


def test_python_components_with_a_generator_and_a_container(tmp_path: Path) -> None:
    document = {
        "run": {"step": 0.01, "stop": 5.0},
        "components": {
            "noise": {"model": f"{MODEL}:Noise"},
            "mean": {"model": f"{MODEL}:Mean"},
        },
        "links": [{"from": "noise.y", "to": "mean.u", "semantics": "last-arrival",
                   "delay": {"law": "uniform", "low": 0.02, "high": 0.2}}],
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document))


def test_a_run_may_be_resumed_again_and_again(tmp_path: Path) -> None:
    def make() -> Scenario:
        return load(CONFIGS / "teleoperation.toml", ["run.stop=3"])

    simulate(make(), tmp_path / "whole")
    place, left = tmp_path / "cut-0", iter(range(1, 6))
    kept(tmp_path / "kept", make(), {300: place})
    for number, tick in zip(left, (700, 1200, 1300, 2500, 2600), strict=True):
        after = tmp_path / f"cut-{number}"
        done = []

        def copy(now: int, _: int, place: Path = place, after: Path = after, tick: int = tick,
                 done: list[int] = done) -> None:  # fmt: skip
            if now >= tick and not done:
                done.append(now)
                shutil.copytree(place, after)

        interval = 1e9 if number % 2 else 0.0
        keeper = CheckpointKeeper(CheckpointInterval(interval), {}, Resumption.open(place))
        simulate(make(), place, copy, execution=Execution(1, keeper))
        keeper.end()
        assert contents(place) == contents(tmp_path / "whole")
        place = after
    resumed(place, make())
    assert contents(place) == contents(tmp_path / "whole")


@pytest.fixture
def stopped(tmp_path: Path) -> Iterator[Path]:
    """A run that was stopped by an error between two chunks."""
    folder = tmp_path / "stopped"

    def stop(done: int, _: int) -> None:
        if done > 1000:
            raise RuntimeError

    scenario = load(CONFIGS / "teleoperation.toml", ["run.stop=3"])
    with pytest.raises(RuntimeError):
        simulate(
            scenario,
            folder,
            stop,
            execution=Execution(1, CheckpointKeeper(CheckpointInterval(0.0), {})),
        )
    yield folder


def test_a_run_that_was_stopped_and_closed_is_resumed(stopped: Path) -> None:
    scenario = load(CONFIGS / "teleoperation.toml", ["run.stop=3"])
    assert (stopped / "trajectories.parquet").exists()
    assert resumed(stopped, scenario) > 900
    simulate(scenario, stopped.with_name("whole"))
    assert contents(stopped) == contents(stopped.with_name("whole"))
