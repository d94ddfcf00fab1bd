"""The analysis of a run that is read in pieces is that of whole columns."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.analysis import recorded_numbers
from cosim.analysis.analysis import analyse
from cosim.analysis.analyzed_port import of_run
from cosim.analysis.recorded_numbers import approach
from cosim.measure import felt_impedance
from cosim.measure.energy import effort
from cosim.measure.felt_impedance import _accelerated, fit_impedance
from cosim.reporting.analysis import draw
from tests.cosim.record.in_pieces import read_in_pieces, recorded

SIZES = st.lists(st.integers(1, 40), min_size=1, max_size=30)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("run"), "teleoperation", "9 s")


def test_an_analysis_does_not_depend_on_pieces(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = analyse(of_run(folder), tests=False)
    read_in_pieces(monkeypatch)
    found = analyse(of_run(folder), tests=False)
    assert len(list(found.recorded)) == 9 and found.recorded.far
    assert found.as_data() == expected.as_data() and len(found.run) > 8
    paths = draw(found, tmp_path / "found")
    for path, other in zip(paths, draw(expected, tmp_path / "expected"), strict=True):
        assert path.read_bytes() == other.read_bytes()


def cut(sizes: list[int], *columns: Any) -> list[Any]:
    """Columns in pieces."""
    ends = np.cumsum(sizes)
    edges = [0, *ends[ends < len(columns[0])], len(columns[0])]
    return [tuple(x[a:b] for x in columns) for a, b in pairwise(edges)]


@settings(max_examples=60, deadline=None)
@given(SIZES, st.integers(1, 200), st.booleans(), st.integers(0, 99))
def test_accelerations_are_those_of_numpy(
    sizes: list[int], rows: int, even: bool, seed: int
) -> None:
    random = np.random.default_rng(seed)
    t = np.arange(rows) / 64 if even else np.cumsum(random.uniform(0.1, 1.0, rows))
    rate = random.normal(size=(rows, 2))
    found = list(_accelerated(cut(sizes, t, rate, rate, rate), 1 / 64 if even else None))
    expected = np.gradient(rate, t, axis=0) if rows > 1 else np.zeros_like(rate)
    assert np.concatenate([x[0] for x in found]).tolist() == t.tolist()
    assert np.concatenate([x[3] for x in found]).tolist() == rate.tolist()
    assert np.concatenate([x[4] for x in found]).tolist() == expected.tolist()


@settings(max_examples=40, deadline=None)
@given(SIZES, st.integers(0, 99), st.integers(0, 400))
def test_numbers_of_a_port_do_not_depend_on_pieces(sizes: list[int], seed: int, more: int) -> None:
    rows = 801 + more
    t: Any = 0.02 * np.arange(rows)
    random = np.random.default_rng(seed)
    w = random.uniform(0.5, 3.0, (3, 2))
    q, dq = np.cos(np.outer(t, w[0])), -w[0] * np.sin(np.outer(t, w[0]))
    q, dq = q + np.sin(np.outer(t, w[1])), dq + w[1] * np.cos(np.outer(t, w[1]))
    f = q + 2.0 * dq + random.normal(size=q.shape)
    span = (t[0], t[-1])
    assert fit_impedance(cut(sizes, t, f, q, dq), span, 2.0) == fit_impedance(
        [(t, f, q, dq)], span, 2.0
    )
    assert effort(cut(sizes, t, f), span) == effort([(t, f)], span)
    e = np.exp(-0.9 * t) * np.abs(np.cos(5 * t))
    assert approach(cut(sizes, t, e), rows) == approach([(t, e)], rows)
    assert not np.isnan(approach([(t, e)], rows)).any()


def test_of_many_rows_some_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    t: Any = 1e-3 * np.arange(40_001)
    q, dq, ddq = np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)
    for w in (0.7, 2.3, 5.1):
        q += 1 - np.cos(w * t)
        dq += w * np.sin(w * t)
        ddq += w * w * np.cos(w * t)
    rows: Any = tuple(x[:, None] for x in (1.5 * ddq + 0.5 * dq + 3.0 * q, q, dq))
    error = np.exp(-0.4 * t)
    monkeypatch.setattr(felt_impedance, "FITTED", 300)
    monkeypatch.setattr(recorded_numbers, "FITTED", 300)
    (found,) = fit_impedance([(t, *rows)], (0.0, 40.0), 40.0)
    assert (found.inertia, found.damping, found.stiffness) == pytest.approx(
        (1.5, 0.5, 3.0), rel=1e-3
    )
    again = fit_impedance(cut([1, 3, 1000, 7], t, *rows), (0.0, 40.0), 40.0)
    assert again == (found,)
    assert approach([(t, error)], len(t))[0] == pytest.approx(-0.4, rel=1e-9)
    assert approach(cut([17, 9000], t, error), len(t)) == approach([(t, error)], len(t))
