"""Times of events, which are between ticks: recorded where a scenario asks for them."""

from __future__ import annotations

import csv
from math import sqrt
from pathlib import Path
from typing import Any

import pytest

from cosim.base.errors import ScenarioError
from cosim.engine.simulate import simulate
from cosim.record import Run
from cosim.scenario.spec import build
from tests.cosim.fmi.exporter import events3, exchange2, exchange3, export
from tests.cosim.fmi.test_exchange import BALL, COUNTS


def ran(path: Path, folder: Path, run: dict[str, Any], **component: Any) -> Path:
    document = {
        "run": {"step": 0.25, "stop": 1.0, "record": {"events": True}, **run},
        "components": {"x": {"model": str(path), **component}},
    }
    return simulate(build(document, folder / "s.toml"), folder / "run", force=True).folder


def times(folder: Path) -> list[float]:
    with (folder / "events.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["t", "component"] and all(name == "x" for _, name in rows[1:])
    return [float(t) for t, _ in rows[1:]]


def test_time_events_and_ticks_of_co_simulation(tmp_path: Path) -> None:
    """Time events every 0.3 s, within steps of 0.25 s; a clock that ticks every 0.5 s."""
    clock = 'intervalVariability="constant" intervalDecimal="0.5"'
    path = export(events3(clock), tmp_path / "x.fmu")
    folder = ran(path, tmp_path, {})
    assert times(folder) == pytest.approx([0.0, 0.3, 0.5, 0.6, 0.9], abs=1e-12)
    assert Run.open(folder).metadata["events"] == {"x": 5}


@pytest.mark.parametrize("text", [exchange2(), exchange3()], ids=["2.0", "3.0"])
def test_located_events_of_model_exchange(tmp_path: Path, text: str) -> None:
    """Time events every 0.15 s, and the first time that a ball from 1 m hits the ground; at 0 the
    discrete inputs are set.
    """
    path = export(text, tmp_path / "x.fmu")
    folder = ran(path, tmp_path, {}, parameters={"model": COUNTS, "period": 0.15})
    assert times(folder) == pytest.approx([0.15 * k for k in range(7)], abs=1e-12)
    folder = ran(path, tmp_path, {"step": 0.1, "stop": 0.5}, parameters={"model": BALL})
    assert times(folder) == pytest.approx([0.0, sqrt(2.0 / 9.81)], abs=1e-9)


def test_nothing_is_written_unless_asked(tmp_path: Path) -> None:
    path = export(events3(), tmp_path / "x.fmu")
    folder = ran(path, tmp_path, {"step": 0.1, "record": {}})
    assert not (folder / "events.csv").exists() and "events" not in Run.open(folder).metadata


def test_what_cannot_be_told_is_refused(tmp_path: Path) -> None:
    path = export(events3(), tmp_path / "x.fmu")
    with pytest.raises(ScenarioError, match="x is isolated"):
        ran(path, tmp_path, {"step": 0.1}, isolate=True)
