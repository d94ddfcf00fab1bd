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
    found = list(_accelerated(cut(sizes, t, -rate, -rate, rate)))
    expected = np.gradient(rate, t, axis=0) if rows > 1 else np.zeros_like(rate)
    assert np.concatenate([x[0] for x in found]).tolist() == t.tolist()
    assert np.concatenate([x[1] for x in found]).tolist() == expected.tolist()
    assert np.concatenate([x[2] for x in found]).tolist() == rate.tolist()


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


def test_felt_impedance_is_that_of_numpy() -> None:
    t: Any = 1e-3 * np.arange(30_001) + 7.0
    random = np.random.default_rng(5)
    w = np.array([[0.7, 1.9], [2.3, 3.1], [5.1, 0.9]])
    q, dq = _moving(t, w)
    f = 80.0 + 3.0 * q + 0.5 * dq + random.normal(size=q.shape)
    found = fit_impedance(cut([1, 999, 20_000], t, f, q, dq), (t[0], t[-1]), 10.0)
    assert [(x.joint, x.start) for x in found] == [
        (j, 7.0 + k) for k in (0, 10, 20) for j in (0, 1)
    ]
    ddq = np.gradient(dq, t, axis=0)
    for x in found:
        rows, j = (t >= x.start) & (t <= x.stop), x.joint
        table = np.stack([ddq[rows, j], dq[rows, j], q[rows, j], np.ones(rows.sum())], axis=1)
        expected, left, _, _ = np.linalg.lstsq(table, f[rows, j], rcond=None)
        assert [x.inertia, x.damping, x.stiffness] == pytest.approx(expected[:3], rel=1e-10)
        share = np.sqrt(left[0] / rows.sum()) / f[rows, j].std()
        assert x.residual == pytest.approx(share, rel=1e-10)


def _moving(t: Any, w: Any) -> tuple[Any, Any]:
    """Positions and velocities (n, 2) of sums of swings with the frequencies w (k, 2), rad/s."""
    phases = t[:, None, None] * w
    return np.sin(phases).sum(axis=1), (w * np.cos(phases)).sum(axis=1)


def test_a_known_impedance_is_felt() -> None:
    """A mass of 1.5 kg, 0.5 N.s/m and 3 N/m, moved through three frequencies, of 40 001 rows."""
    t: Any = 1e-3 * np.arange(40_001)
    w = np.array([[0.7], [2.3], [5.1]])
    q, dq = _moving(t, w)
    ddq = -(w**2 * np.sin(t[:, None, None] * w)).sum(axis=1)
    f = 1.5 * ddq + 0.5 * dq + 3.0 * (q - 20.0)
    (found,) = fit_impedance(cut([17, 9000], t, f, q, dq), (0.0, 40.0), 40.0)
    assert (found.inertia, found.damping, found.stiffness) == pytest.approx(
        (1.5, 0.5, 3.0), rel=1e-5
    )
    assert found.residual < 1e-4  # the derivative is of first order at the ends


@settings(max_examples=20, deadline=None)
@given(SIZES, st.integers(1, 300), st.integers(0, 99))
def test_a_decay_is_that_of_numpy(sizes: list[int], rows: int, seed: int) -> None:
    """The envelope of an error that swings, in blocks of any number of rows, and its slope."""
    t: Any = 0.02 * np.arange(901)
    random = np.random.default_rng(seed)
    e = np.exp(-0.9 * t) * np.abs(np.cos(5 * t + random.uniform(0, 6))) + np.exp(-0.9 * t) * 0.1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorded_numbers, "ROWS", rows)
        found = approach(cut(sizes, t, e), len(t))
    first, last = (int(np.flatnonzero(e > share * e[0])[-1]) + 1 for share in (1e-2, 1e-5))
    envelope = np.log(np.maximum.accumulate(e[::-1])[::-1][first:last])
    fitted = t[first:last]
    ends = np.linspace(0, len(fitted), 4).astype(int)
    slope, *thirds = (
        np.polyfit(fitted[a:b], envelope[a:b], 1)[0] for a, b in ((0, len(fitted)), *pairwise(ends))
    )
    assert found[0] == pytest.approx(slope, rel=1e-10)
    assert found[1] == pytest.approx(2 * np.std(thirds, ddof=1) / np.sqrt(3), rel=1e-8)
    assert found[2] == fitted[-1] - fitted[0]


def test_the_rate_of_an_exponential() -> None:
    t: Any = 1e-3 * np.arange(40_001)
    rate, uncertain, seconds = approach([(t, np.exp(-0.4 * t))], len(t))
    assert rate == pytest.approx(-0.4, rel=1e-12) and uncertain < 1e-12
    assert seconds == pytest.approx(np.log(1e3) / 0.4, abs=2e-3)
