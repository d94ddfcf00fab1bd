"""Verdict, curves and aligned errors of a run that is read in pieces, and of whole columns."""

from __future__ import annotations

from math import nan, sqrt
from pathlib import Path

import numpy as np
import pytest

from cosim.api import answers
from cosim.base.errors import RunError
from cosim.comparison.aligned import AlignedError
from cosim.comparison.measure import _curves
from cosim.comparison.spec import Picture, Stability
from cosim.comparison.verdict import judge
from cosim.record import Column, Run
from cosim.record import run as reading
from cosim.record.groups import GroupWriter

ROWS, STEP = 5001, 0.003
T = STEP * np.arange(ROWS)
NAMES = ["a.q[0]", "a.q[1]", "b.q[0]", "b.q[1]", "a.dq[0]", "a.dq[1]", "a.w"]
HOW = Stability(
    position=("a.q",), velocity=("a.dq",), position_limit=50.0, velocity_limit=100.0, rest=0.01,
    window=2.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five row groups of two joints that swing, another arm behind them, and a wild signal."""
    place = tmp_path_factory.mktemp("run")
    swing = np.exp(-0.05 * T)[:, None] * np.sin(np.outer(T, [3.0, 4.0]))
    late = np.exp(-0.05 * T)[:, None] * np.sin(np.outer(T - 0.4, [3.0, 4.0]))
    rates = np.gradient(swing, STEP, axis=0)
    wild = np.exp(T)[:, None]
    rows = np.zeros((ROWS, 1023))
    rows[:, :7] = np.concatenate((swing, late, rates, wild), axis=1)
    names = [*NAMES, *(f"c.y[{i}]" for i in range(1023 - len(NAMES)))]
    units = {"a.dq[0]": "rad/s", "a.dq[1]": "rad/s"}
    columns = [Column(name, units.get(name, "rad"), i) for i, name in enumerate(names)]
    writer = GroupWriter(place / "trajectories.parquet", columns, h=STEP)
    writer.add(rows, 0, last=True)
    writer.close()
    return place


def both(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Run, Run]:
    """The run as a whole and in pieces."""
    whole, long = Run.open(folder), Run.open(folder)
    monkeypatch.setattr(reading, "PIECE", 1)
    monkeypatch.setattr(Run, "is_long", property(lambda run: run is long))
    return whole, long


def test_a_verdict_does_not_depend_on_pieces(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, long = both(folder, monkeypatch)
    assert len(list(long.pieces(("a.q",)))) == 5
    expected = judge(whole, HOW)
    assert expected.kind == "settling" and judge(long, HOW) == expected
    x, v = whole.array("a.q"), whole.array("a.dq")
    assert expected.motion == {"a.q": np.abs(x - x[0]).max()}
    assert expected.speed == np.abs(v)[whole.t >= whole.t[-1] - 2.0].max()
    wild = Stability(
        position=("a.w",), velocity=("a.dq",), position_limit=50.0, velocity_limit=100.0,
        rest=0.01, window=2.0,
    )  # fmt: skip
    first = float(T[np.argmax(np.exp(T) > 50.0)])
    assert judge(whole, wild).time == judge(long, wild).time == pytest.approx(first)
    stopped = RunError("no")
    assert repr(judge(long, HOW, stopped)) == repr(judge(whole, HOW, stopped))


@pytest.mark.parametrize("delay", [0.0, 0.4, 5.0005, 14.99, 16.0, nan])
def test_an_aligned_error_does_not_depend_on_pieces(
    folder: Path, delay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, long = both(folder, monkeypatch)
    error = AlignedError("e", "a.q", "b.q", "a->b")
    expected = error.evaluate(whole, delay)
    assert repr(error.evaluate(long, delay)) == repr(expected)
    if not delay < 15.0:
        return
    t, x, y = whole.t, whole.array("a.q"), whole.array("b.q")
    later = t[t >= t[0] + delay]
    shifted = np.stack([np.interp(later - delay, t, x[:, i]) for i in range(2)], axis=1)
    square = np.einsum("ij,ij->i", *[shifted - y[-len(later) :]] * 2)
    integral = 0.5 * np.sum(np.diff(later) * (square[1:] + square[:-1]))
    assert expected.value == pytest.approx(sqrt(integral / (later[-1] - later[0])), rel=1e-12)


@pytest.mark.parametrize("until", [7.0, 40.0])
def test_curves_do_not_depend_on_pieces(
    folder: Path, until: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, long = both(folder, monkeypatch)
    picture = Picture(y=("a.q", "a.w"), until=until)
    found = [_curves(run, picture) for run in (whole, long)]
    for expected, curve in zip(*found, strict=True):
        assert curve.name == expected.name and len(curve.t) <= 400
        assert curve.t.tolist() == expected.t.tolist() and curve.t[-1] <= np.float32(until)
        assert curve.y.tolist() == expected.y.tolist()


@pytest.mark.parametrize("to", ["b.q", [0.5, -0.5]])
def test_an_overshoot_does_not_depend_on_pieces(
    folder: Path, to: str | list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, long = both(folder, monkeypatch)
    expected = answers.overshoot(whole, "a.q", to, 0.1)
    assert answers.overshoot(long, "a.q", to, 0.1) == expected
    aim = whole.array("b.q") if to == "b.q" else np.array([to])
    x = whole.array("a.q")
    beyond = (np.sign(aim[-1] - x[0]) * (x - aim)).max()
    assert f"by {beyond:.6g} rad" in expected.text
