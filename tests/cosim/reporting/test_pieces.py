"""Pages of a run that is read in pieces are those of whole columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.record import Run
from cosim.record.piecewise import at_times
from cosim.reporting.run_report import write_report
from cosim.reporting.thinning import Thinned, thin
from tests.cosim.record.in_pieces import read_in_pieces, recorded


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("run"), "teaching", "7 s")


def in_pieces(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    read_in_pieces(monkeypatch)
    return Run.open(folder)


def test_a_report_does_not_depend_on_pieces(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = write_report(Run.open(folder)).read_bytes()
    found = write_report(in_pieces(folder, monkeypatch)).read_bytes()
    assert found == expected and len(expected) > 100_000


def test_values_between_rows_do_not_depend_on_pieces(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Run.open(folder)
    t = np.sort(np.concatenate((np.linspace(-1, 9, 777), whole.t[1020:1030], [whole.t[-1]])))
    found = at_times(in_pieces(folder, monkeypatch), ["robot.q[0]"], t)["robot.q[0]"]
    assert (found == np.interp(t, whole.t, whole.column("robot.q[0]"))).all()


@settings(max_examples=150, deadline=None)
@given(
    st.integers(1, 3000), st.integers(4, 300), st.lists(st.integers(1, 700), min_size=1),
    st.integers(0, 9), st.sampled_from([(), (np.nan,), (np.nan, np.inf, -np.inf)]),
)  # fmt: skip
def test_thinning_does_not_depend_on_pieces(
    count: int, most: int, sizes: list[int], seed: int, special: tuple[float, ...]
) -> None:
    random = np.random.default_rng(seed)
    y = random.integers(-5, 6, count) * 1.0  # with equal extremes
    for value in special:
        y[random.integers(0, count, 2)] = value
    kept, at = Thinned(count, most), 0
    for size in [*sizes, count]:
        if at < count:
            kept.add(y[at : at + size])
        at += size
    assert kept.rows.tolist() == thin(y, most).tolist()
    assert np.array_equal(kept.y, y[kept.rows], equal_nan=True)
    assert kept.greatest == np.abs(y[np.isfinite(y)]).max(initial=0.0)
