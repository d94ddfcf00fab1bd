"""Rehearsals, twins and nodes that were cut short are read and completed from their journals."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bridge.deployment.system import System
from bridge.native import journal
from bridge.native.journal import Journal
from bridge.recording import recovered
from bridge.replay import twin
from bridge.results.outcome import begin, run_twin
from cosim.base.errors import CutShort, Interrupted, ScenarioError
from cosim.engine.recovery import repair
from cosim.record import Run, verify
from cosim.scenario.assemble import assemble
from cosim.scenario.recorded import with_recorded_links
from tests.bridge.deployments import named

#: The plant's parameter is another one than the scenario's: recovery has to use the run's own.
SETTINGS = ("run.stop=2", "components.master.parameters.k_p=20")


@pytest.fixture
def system() -> System:
    return named("can", *SETTINGS)


@pytest.fixture
def cut(system: System, tmp_path: Path) -> Path:
    """As a process that was killed before it collected leaves a folder."""
    folder = tmp_path / "cut"
    (folder / "nodes").mkdir(parents=True)
    begin(system, folder, {"settings": list(SETTINGS)})
    twin.simulate(system, folder / "nodes")
    return folder


@pytest.fixture
def whole(system: System, tmp_path: Path) -> Run:
    return Run.open(run_twin(system, tmp_path / "whole", SETTINGS))


def same(a: Run, b: Run) -> bool:
    tables = [{name: path.read_bytes() for name, path in r.link_tables.items()} for r in (a, b)]
    columns = all(np.array_equal(a.column(n), b.column(n)) for n in ("t", *a.names))
    return a.names == b.names and columns and tables[0] == tables[1] != {}


def test_a_reader_collects_the_journals_by_itself(cut: Path, whole: Run) -> None:
    before = sorted(cut.rglob("*"))
    with pytest.warns(CutShort, match="was interrupted; it is recorded until t = 1.999 s"):
        found = Run.open(cut)
    assert same(found, whole)
    assert sorted(cut.rglob("*")) == before  # nothing was written there


def test_readers_share_what_was_collected_until_the_journals_change(
    cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    collected: list[Path] = []
    collect = recovered.collect

    def counted(folder: Path, into: Path) -> None:
        collected.append(into)
        collect(folder, into)

    monkeypatch.setattr(recovered, "collect", counted)
    with pytest.warns(CutShort):
        first, second = Run.open(cut), Run.open(cut)
    assert first.link_tables == second.link_tables
    assert len(collected) == 1
    os.utime(next((cut / "nodes").glob("*.journal")), ns=(0, 0))
    with pytest.warns(CutShort):
        Run.open(cut)
    assert len(collected) == 2


def test_its_links_are_links_of_another_run(cut: Path, system: System, whole: Run) -> None:
    plans = [
        with_recorded_links(assemble(system.scenario), run) for run in (cut, whole.path.parent)
    ]
    held = [[x.table.stream(400).rows(400).tolist() for x in plan.links] for plan in plans]
    assert held[0] == held[1]


def test_recover_completes_the_folder_as_its_end_would_have(cut: Path, whole: Run) -> None:
    (cut / "trajectories.live").write_bytes(b"half of it")  # killed while it collected
    (cut / "trajectories.parquet.part").write_bytes(b"PAR1")
    assert repair(cut) == "recorded until t = 1.999 s"
    assert same(Run.open(cut), whole)
    assert Run.open(cut).metadata["status"] == "recovered"
    top = {path.name for path in cut.iterdir()}
    assert top == {"trajectories.parquet", "links", "nodes", "run.json"}
    assert repair(cut) == ""


def test_killed_between_its_trajectories_and_its_tables(cut: Path, whole: Run) -> None:
    (cut / "trajectories.parquet").write_bytes(whole.path.read_bytes())
    repair(cut)
    assert same(Run.open(cut), whole)


def test_nobody_recovers_what_is_still_being_written(cut: Path) -> None:
    with Journal.create(cut / "nodes" / "late.journal", np.dtype([("slot", "<i8")]), 4):
        with pytest.raises(ScenarioError, match="the run is still active"):
            repair(cut)
        with pytest.warns(CutShort, match="the run is still active; it is recorded until"):
            Run.open(cut)


def test_ctrl_c_of_a_twin_keeps_what_was_simulated(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def pressed(stop: Callable[[], None]) -> Iterator[None]:
        stop()
        yield
        raise KeyboardInterrupt

    monkeypatch.setattr(twin, "stop_on_signal", pressed)
    with pytest.raises(Interrupted, match="interrupted at t = "):
        run_twin(system, tmp_path / "here", SETTINGS)
    run = Run.open(tmp_path / "here")
    assert run.t[-1] == pytest.approx(1.0, abs=0.01)
    assert run.metadata["status"] == "stopped"
    assert run.metadata["deployment"]["settings"] == list(SETTINGS)
    verify(tmp_path / "here")


@pytest.mark.parametrize("made", [0, 2, 4])
def test_a_twin_interrupted_while_its_journals_are_made_says_so(
    system: System, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: int
) -> None:
    left, mapped = [made], journal._mapped

    def some(descriptor: int, size: int) -> object:
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        return mapped(descriptor, size)

    monkeypatch.setattr(journal, "_mapped", some)
    with pytest.raises(Interrupted, match="interrupted at t = 0 s"):
        run_twin(system, tmp_path / "here", SETTINGS)
    verify(tmp_path / "here")
    with pytest.raises(ScenarioError, match="nothing was recorded"):
        Run.open(tmp_path / "here")


def test_a_twin_is_the_same_however_often_it_is_looked_at(
    system: System, whole: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(twin, "LOOK_NS", 1_300_000)
    assert same(Run.open(run_twin(system, tmp_path / "often", SETTINGS)), whole)
