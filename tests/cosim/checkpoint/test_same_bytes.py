"""A run that is resumed from a checkpoint: the same bytes as without interruption.

A folder that is copied during the run is what a process leaves that is killed at that moment.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest

from cosim.checkpoint import CheckpointKeeper, Resumption
from cosim.engine import simulate as simulation
from cosim.engine.simulate import Execution, simulate
from cosim.loading.files import load
from cosim.record.folder import CHECKPOINTS
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.cosim.fmi.exporter import events3, exchange2, exchange3, export
from tests.cosim.fmi.test_exchange import BALL

MODEL = "tests.cosim.checkpoint.blocks"
Make = Callable[[], Scenario]


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation, "CHUNK_TICKS", 64)


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

    execution = Execution(threads, CheckpointKeeper(0.0, {}))
    simulate(scenario, folder, copy, execution=execution)
    assert not left and not (folder / CHECKPOINTS).exists()


def resumed(folder: Path, scenario: Scenario, threads: int = 1, interval: float = 1e9) -> int:
    """Resume a run to its end; the tick from which on."""
    found = Resumption.open(folder)
    keeper = CheckpointKeeper(interval, {}, found)
    simulate(scenario, folder, execution=Execution(threads, keeper))
    return found.tick


def same_after_cuts(folder: Path, make: Make, threads: int = 1, cuts: int = 3) -> None:
    """Compare a run with those resumed from copies at random ticks."""
    scenario = make()
    ticks = assemble(scenario).ticks
    simulate(scenario, folder / "whole", execution=Execution(threads))
    whole = contents(folder / "whole")
    at = Random(folder.name).sample(range(64, ticks - 64), cuts)
    copies = {tick: folder / f"cut-{tick}" for tick in at}
    kept(folder / "kept", make(), copies, threads)
    assert contents(folder / "kept") == whole
    for tick, path in copies.items():
        start = resumed(path, make(), threads)
        assert tick - 64 <= start <= tick + 64
        assert contents(path) == whole


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


@pytest.mark.parametrize("threads", [1, 2])
def test_parts_of_a_plan_that_threads_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    monkeypatch.setattr("cosim.engine.binding.LEAST", 2)
    monkeypatch.setattr("cosim.engine.binding.ALONE", 2)
    monkeypatch.setattr(simulation, "EVERYTHING", 10)
    settings = ("graphs.net.n=40", "run.stop=1", "run.record.every=3")
    same_after_cuts(tmp_path, lambda: load(CONFIGS / "many.toml", settings), threads)


def built(folder: Path, document: dict[str, Any]) -> Make:
    return lambda: build(document, folder / "s.toml")


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


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("solver", ["rk4", "heun"])
def test_model_exchange_with_events(tmp_path: Path, fmi: str, solver: str) -> None:
    """A ball that bounces, integrated here."""
    flags = {"2.0": 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"',
             "3.0": 'canGetAndSetFMUState="true" canSerializeFMUState="true"'}[fmi]  # fmt: skip
    text = (exchange2 if fmi == "2.0" else exchange3)(flags)
    path = export(text, tmp_path / "ball.fmu")
    document = {
        "run": {"step": 0.003, "stop": 3.0, "record": {"events": True}},
        "components": {"x": {"model": str(path), "parameters": {"model": BALL},
                             "solver": solver, "log": True}},
    }  # fmt: skip
    same_after_cuts(tmp_path, built(tmp_path, document))


def test_clocks_and_events_of_co_simulation(tmp_path: Path) -> None:
    clock = 'intervalVariability="constant" intervalDecimal="0.5"'
    saves = 'hasEventMode="true" canGetAndSetFMUState="true" canSerializeFMUState="true"'
    text = events3(clock).replace('hasEventMode="true"', saves)
    path = export(text, tmp_path / "x.fmu")
    document = {
        "run": {"step": 0.01, "stop": 4.0, "record": {"events": True}},
        "components": {"x": {"model": str(path)}},
    }
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
        keeper = CheckpointKeeper(interval, {}, Resumption.open(place))
        simulate(make(), place, copy, execution=Execution(1, keeper))
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
        simulate(scenario, folder, stop, execution=Execution(1, CheckpointKeeper(0.0, {})))
    yield folder


def test_a_run_that_was_stopped_and_closed_is_resumed(stopped: Path) -> None:
    scenario = load(CONFIGS / "teleoperation.toml", ["run.stop=3"])
    assert (stopped / "trajectories.parquet").exists()
    assert resumed(stopped, scenario) > 900
    simulate(scenario, stopped.with_name("whole"))
    assert contents(stopped) == contents(stopped.with_name("whole"))
