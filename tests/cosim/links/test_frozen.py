"""Frozen traces: the recipe in plain Python, the sums, the format, and their statistics."""

from __future__ import annotations

import csv
import io
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.cli.delays import figures_of_preset, figures_of_trace
from cosim.links.frozen import ROWS, TRACES, frozen, write_traces
from cosim.links.spec import delay_law
from cosim.links.traces import read_trace
from tests.tiers import first_fast

MASK = 2**64 - 1


def word(seed, stream, i):
    x = (seed + ((stream << 40) + i) * 0x9E3779B97F4A7C15) & MASK
    x = (x ^ x >> 30) * 0xBF58476D1CE4E5B9 & MASK
    x = (x ^ x >> 27) * 0x94D049BB133111EB & MASK
    return ((x ^ x >> 31) >> 32) * 10**6 >> 32


def recipe(trace, rows):
    """The delays in µs, as the module's text describes them, row by row; None: lost."""
    found, before, bad = [], None, False
    for k in range(rows):
        u = word(trace.seed, 0, 1 + k // trace.hold)
        (u_a, a), (u_b, b) = next(p for p in pairwise(trace.quantiles) if p[0][0] <= u < p[1][0])
        T = a + (b - a) * (u - u_a) // (u_b - u_a)
        if trace.levels:
            s = trace.levels
            T += s.low + (s.high - s.low) * word(trace.seed, 1, 1 + k // s.rows) // 10**6
            T += sum(s.spike for first, last in s.windows if first <= k % s.rows < last)
        if trace.queue and before is not None:
            T = max(T, before - 5000)
        before = T
        if trace.enter:
            u = word(trace.seed, 2, 1 + k)
            bad = u >= trace.leave if bad else u < trace.enter
        found.append(None if bad else T)
    return found


def test_in_messages_a_trace_has_the_name_given_or_its_title():
    trace = frozen(next(iter(TRACES)))
    assert trace.trace(name="delay of the link").file == "delay of the link"
    assert trace.trace().file == trace.title != ""


@pytest.mark.parametrize("name", TRACES)
def test_the_recipe_in_plain_integers_gives_the_same_rows(name):
    rows = 3100  # beyond one cycle of 15 s
    found = TRACES[name].delays()[:rows].tolist()
    assert [None if T < 0 else T for T in found] == recipe(TRACES[name], rows)


def test_splitmix64_gives_its_published_words():
    """The first outputs of SplitMix64 from seed 0 are E220A8397B1DCDAF, 6E789E6AA1B965F4."""
    assert word(0, 0, 1) == 0xE220A839 * 10**6 >> 32
    assert word(0, 0, 2) == 0x6E789E6A * 10**6 >> 32


@pytest.mark.parametrize("name", first_fast(TRACES, 4))
def test_the_text_of_a_trace_has_its_sum_and_reads_back(name, tmp_path: Path):
    trace = TRACES[name]
    text = trace.text()
    assert sha256(text.encode()).hexdigest() == trace.sha256
    rows = list(csv.reader(io.StringIO(text)))
    assert rows[0] == ["t_send", "delay"] and len(rows) == ROWS + 1
    path = tmp_path / "trace.csv"
    path.write_text(text, encoding="utf-8")
    read, law = read_trace(path), delay_law({"law": "frozen", "name": name}, tmp_path)
    np.testing.assert_array_equal(read.delay, law.delay)
    np.testing.assert_array_equal(read.t_send, law.t_send)
    assert read.duration == pytest.approx(120.0)


def test_sums_and_names_are_each_there_once():
    assert len({t.sha256 for t in TRACES.values()}) == len(TRACES) == 16
    assert len({t.seed for t in TRACES.values()}) == len(TRACES)


def test_a_changed_trace_is_noticed():
    with pytest.raises(ScenarioError, match="has the SHA-256 sum"):
        replace(frozen("lte-up"), seed=99).text()


def test_traces_are_written_with_their_sums(tmp_path: Path):
    assert write_traces(tmp_path / "traces") == len(TRACES)
    for line in (tmp_path / "traces" / "SHA256SUMS").read_text(encoding="utf-8").splitlines():
        total, name = line.split()
        assert sha256((tmp_path / "traces" / name).read_bytes()).hexdigest() == total


def test_a_trace_has_the_quantiles_of_its_knots():
    """Independent draws: the share below a knot is its u; five standard errors."""
    for name in ("paper-up", "netfi-dlm-2-up", "telesim-medium-down"):
        trace = frozen(name)
        T = trace.delays()[:: trace.hold]
        T = T[T >= 0]
        for u, value in trace.quantiles[1:-1]:
            share = u / 1e6
            error = 5 * (share * (1 - share) / T.size) ** 0.5
            assert np.mean(value > T) == pytest.approx(share, abs=error), (name, u)


def test_packets_of_a_queue_leave_in_order():
    for name in ("lte-up", "wifi5-down", "leo-up", "geo-down"):
        T = replace(frozen(name), enter=0).delays()
        assert (np.diff(T) >= -5000).all()
        assert (np.diff(T) == -5000).any()  # what waited behind a late packet arrives with it


def test_a_satellite_changes_its_level_and_has_spikes_each_15_s():
    T = replace(frozen("leo-up"), enter=0).delays().reshape(8, 3000) / 1e3
    assert (T[:, :25].mean(axis=1) > T[:, 200:2800].mean(axis=1) + 30).all()
    assert np.ptp(np.median(T, axis=1)) > 3


@pytest.mark.parametrize(
    ("trace", "preset"), [("paper-up", "paper"), ("netfi-dlm-2-down", "netfi-dlm-2"),
                          ("telesim-medium-up", "telesim-medium"), ("5g-down", "5g-down")]
)  # fmt: skip
def test_traces_resemble_the_preset_of_their_name(trace, preset):
    """Median, 95 % and loss; wider where packets queue."""
    a, b = figures_of_trace(trace), figures_of_preset(preset, 100_000)
    assert (a.p50, a.p95) == pytest.approx((b.p50, b.p95), rel=0.04)
    assert a.lost == pytest.approx(b.lost, abs=0.002)
