"""Numbers of a run that is read in pieces against those of whole columns, to the bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.measure.joint_limits import beyond
from cosim.measure.metrics import Metric, metric
from cosim.record import Column, Run
from cosim.record.digest import digest
from cosim.record.groups import GroupWriter
from cosim.record.piecewise import PairwiseSum, RunningIntegral, Trapezoids
from tests.cosim.formulas.recorded import requirement
from tests.cosim.record.in_pieces import read_in_pieces

ROWS = 7001  # seven row groups of 1024 rows


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 1023 columns, of which the first ones move."""
    place = tmp_path_factory.mktemp("run")
    random = np.random.default_rng(4)
    rows = np.zeros((ROWS, 1023))
    rows[:, :6] = np.cumsum(random.normal(size=(ROWS, 6)), axis=0)
    rows[:, 6] = (np.sin(np.arange(ROWS) / 300) > 0.3) * rows[:, 0]
    rows[:, 7] = np.sin(np.arange(ROWS) / 40) + 0.01 * random.normal(size=ROWS)
    rows[:, 8] = 3.0 * np.exp(-np.arange(ROWS) / 900) * rows[:, 7]
    named = ["a.x[0]", "a.x[1]", "b.x[0]", "b.x[1]", "a.f", "a.v", "a.c", "a.s", "a.e"]
    named += [f"still.y[{i}]" for i in range(1023 - len(named))]
    columns = [Column(name, "rad", i) for i, name in enumerate(named)]
    writer = GroupWriter(place / "trajectories.parquet", columns, h=0.003)
    writer.add(rows, 0, last=True)
    writer.close()
    return place


def in_pieces(folder: Path, values: int, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A run of which a piece has about so many values."""
    read_in_pieces(monkeypatch, values)
    return Run.open(folder)


METRICS: list[Metric] = [
    metric("m", "error", ["a.x"], target="b.x", within=40.0, norm="euclidean"),
    metric("m", "error", ["a.e", "a.s"], target=[0.0], within=1.5),
    metric("m", "error", ["a.e"], target=[0.0], within=0.0001),
    metric("m", "rms_free", ["a.x"], target="b.x", contact=["a.c"]),
    metric("m", "rms_contact", ["a.x"], target=[0.0, 1.0], contact=["a.c"]),
    metric("m", "energy", ["a.f", "a.v", "b.x[0]", "b.x[1]"]),
    *(metric("m", kind, ["a.x", "a.s"]) for kind in ("norm", "integral_abs", "rms", "peak")),
    metric("m", "final", ["a.x", "b.x"]),
    *(metric("m", k, ["a.x", "a.s"], window=w) for k in ("tail_mean", "vibration")
      for w in (0.01, 5.0, 30.0)),
]  # fmt: skip


@pytest.mark.parametrize("values", [1, 6000, 17_000, 100_000])
def test_metrics_do_not_depend_on_pieces(
    folder: Path, values: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Run.open(folder)
    expected = [m.evaluate(whole) for m in METRICS]
    for m, result in zip(METRICS, expected, strict=True):
        assert m.evaluate(in_pieces(folder, values, monkeypatch)) == result
    long = in_pieces(folder, values, monkeypatch)
    assert long.span == (whole.t[0], whole.t[-1])
    found = list(beyond({"a.s": [-0.9, 0.8], "a.x[0]": [-1e9, 1e9]}, long))
    monkeypatch.undo()
    assert found == list(beyond({"a.s": [-0.9, 0.8]}, whole)) and len(found) == 1


def test_metrics_are_those_of_numpy(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The formulas of the module, over whole columns."""
    whole = Run.open(folder)
    t, x, f = whole.t, whole.array("a.x"), whole.array("a.f")[:, 0]
    power = f * whole.array("a.v")[:, 0]
    size = np.sqrt(np.einsum("ij,ij->i", x, x))
    steps = np.diff(t) * (size[1:] + size[:-1])
    E = np.concatenate(([0.0], np.cumsum(np.diff(t) * (power[1:] + power[:-1]) / 2)))
    long = in_pieces(folder, 6000, monkeypatch)

    def value(kind: str, of: list[str], window: float | None = None) -> float:
        return metric("m", kind, of, window=window).evaluate(long).value

    tail = t >= t[-1] - 5.0 * (1 + 1e-9)
    assert value("integral_abs", ["a.x"]) == 0.5 * np.sum(steps)
    assert value("tail_mean", ["a.x"], window=5.0) == size[tail].mean()
    assert value("vibration", ["a.x"], window=5.0) == 0.5 * np.ptp(x[tail], axis=0).max()
    assert value("energy", ["a.f", "a.v"]) == E.min()
    assert value("peak", ["a.x"]) == np.abs(x).max()


CONDITIONS = [
    "always abs(a.s) <= 1 rad",
    "always within [3 s, 9.01 s] max(abs(a.x - b.x)) <= 100 rad",
    "eventually within [6 s, 9 s] a.s >= 2 rad",
    "not always a.e <= 1.5 rad",
    "always a.s <= 2 rad and eventually within 2 s a.e <= -1 rad",
    "eventually within [25 s, 30 s] a.e <= 1 rad",
    "eventually always abs(a.e) <= 0.1 rad",
    "a.e <= 1 rad until within 4 s a.s >= 0.9 rad",
    "a.x[0] <= 5 rad implies always after 1 s a.s >= -0.5 rad",
    "always eventually within 1 s a.s >= 0.9 rad",
    "always (a.s >= 0.9 rad implies eventually within 0.5 s a.s <= 0 rad)",
    "always within 12 s (a.s <= 2 rad until always after 2 s a.e <= 1 rad)",
    "a.x[1] <= 2000 rad until within [3 s, 18 s] always within 2 s a.s >= -2 rad",
]


@pytest.mark.parametrize("condition", CONDITIONS)
@pytest.mark.parametrize("values", [1, 9000])
@pytest.mark.parametrize("end", [None, 40.0])
def test_requirements_do_not_depend_on_pieces(
    folder: Path, condition: str, values: int, end: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Run.open(folder)
    units = {n: u for n, u in whole.units.items() if n != "t"}
    judged = requirement(units, formula=condition)
    expected = judged.evaluate(whole, end)
    assert judged.evaluate(in_pieces(folder, values, monkeypatch), end) == expected


def test_digest_does_not_depend_on_pieces(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = digest(Run.open(folder))
    assert digest(in_pieces(folder, 1, monkeypatch)) == expected


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 150_000), st.lists(st.integers(1, 60_000), min_size=1), st.integers(0, 99))
def test_sums_are_those_of_whole_columns(count: int, sizes: list[int], seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=count) * 10.0 ** np.arange(count).clip(0, 9)
    t = np.cumsum(np.abs(x)) if count else np.zeros(0)
    total, integral, running = PairwiseSum(count), Trapezoids(count), RunningIntegral()
    found, at = [], 0
    for size in [*sizes, count + 1]:
        part = slice(at, at + size)
        if at < count:
            total.add(x[part])
            integral.add(x[part], t[part])
            found.append(running.add(x[part], t[part]))
        at += size
    assert total.value == np.sum(x)
    if count:
        assert integral.value == 0.5 * np.sum(np.diff(t) * (x[1:] + x[:-1]))
        steps = np.diff(t) * (x[1:] + x[:-1]) / 2
        assert (np.concatenate(found) == np.concatenate(([0.0], np.cumsum(steps)))).all()
