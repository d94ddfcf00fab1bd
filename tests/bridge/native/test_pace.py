"""Deadlines and the histogram. Times are compared with the clock itself only."""

from __future__ import annotations

import ctypes as c
import math
import signal
import sys
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native import pace
from cosim.base import clock

SECOND = 1_000_000_000


def filled(values: list[int]) -> pace.Histogram:
    histogram = pace.Histogram()
    for value in values:
        pace.add(histogram, value)
    return histogram


def test_edges_are_the_bins_of_c() -> None:
    edges = pace.edges()
    assert edges.shape == (pace.BINS + 1,)
    assert (edges[0], edges[1024], edges[1088], edges[-1]) == (0, 1_024_000, 2_048_000, 1000 << 26)
    assert np.all(np.diff(edges) > 0)
    for b in (*range(0, pace.BINS, 37), 1023, 1024, 1087, 1088, pace.BINS - 1):
        counts = pace.counts(filled([int(edges[b]), int(edges[b + 1]) - 1]))
        assert counts[b] == 2, b


@given(st.lists(st.integers(-SECOND, 200 * SECOND), min_size=1, max_size=60), st.floats(0, 1))
def test_counts_are_exact_and_quantiles_bound_from_above(values: list[int], q: float) -> None:
    histogram = filled(values)
    counts, edges = pace.counts(histogram), pace.edges()
    expected, _ = np.histogram(np.clip(values, 0, edges[-1] - 1), edges)
    np.testing.assert_array_equal(counts, expected)
    assert (histogram.count, histogram.minimum, histogram.maximum) == (
        len(values), min(values), max(values),
    )  # fmt: skip
    assert histogram.sum == pytest.approx(sum(values), abs=1e-3)
    exact = sorted(values)[max(1, math.ceil(q * len(values))) - 1]
    found = pace.quantile(histogram, q)
    assert exact <= found <= max(values)
    if 0 <= exact < edges[-1]:
        assert found - exact <= max(1000, exact / 64)


def test_quantiles_of_nothing() -> None:
    assert math.isnan(pace.quantile(pace.Histogram(), 0.5))


def test_it_is_the_clock_of_python() -> None:
    before = clock.monotonic_ns()
    between = pace.now()
    assert before <= between <= clock.monotonic_ns()


@pytest.mark.parametrize("spin", [0, 200_000, 10 * SECOND])
def test_it_does_not_wake_early(spin: int) -> None:
    deadline = pace.now() + 2_000_000
    woke = pace.wait(deadline, spin)
    assert deadline <= woke <= pace.now()


def test_a_deadline_that_has_passed_returns_at_once() -> None:
    before = pace.now()
    assert before <= pace.wait(before - SECOND) <= pace.now()
    assert pace.wait(-5) >= before


def test_every_deadline_is_waited_for() -> None:
    start, period = pace.now(), 500_000
    woke = pace.run(start, period, 40)
    assert woke.shape == (40,)
    assert np.all(woke >= start + period * np.arange(40))
    assert np.all(np.diff(woke) >= 0)
    assert pace.run(start, period, 0).shape == (0,)


def test_a_stop_before_it_starts_ends_it() -> None:
    stop = c.c_int32(1)
    before = pace.now()
    assert pace.wait(before + 3600 * SECOND, 0, stop) < before + 3600 * SECOND
    assert pace.run(before, SECOND, 3600, 0, stop).shape == (0,)


def test_a_wait_that_was_stopped_is_none_of_those_that_ended() -> None:
    """Two deadlines have passed; the third is an hour away."""
    stop = c.c_int32(0)
    threading.Timer(0.02, lambda: setattr(stop, "value", 1)).start()
    start = pace.now() - 3600 * SECOND
    woke = pace.run(start, 3600 * SECOND, 5, 7200 * SECOND, stop)
    assert woke.shape == (2,) and np.all(woke >= start + 3600 * SECOND * np.arange(2))


def test_a_stop_in_the_spin_ends_it() -> None:
    stop = c.c_int32(0)
    deadline = pace.now() + 3600 * SECOND
    threading.Timer(0.02, lambda: setattr(stop, "value", 1)).start()
    assert pace.wait(deadline, 3600 * SECOND, stop) < deadline


@pytest.mark.skipif(sys.platform == "win32", reason="signals end sleeps on POSIX")
def test_a_signal_ends_the_sleep_only_with_stop() -> None:
    stop, over = c.c_int32(0), threading.Event()
    main = threading.main_thread().ident
    assert main is not None

    def signals() -> None:
        while not over.wait(0.005):
            signal.pthread_kill(main, signal.SIGALRM)

    old = signal.signal(signal.SIGALRM, lambda *_: None)
    thread = threading.Thread(target=signals)
    thread.start()
    try:
        deadline = pace.now() + 30_000_000
        assert pace.wait(deadline, 0, stop) >= deadline
        deadline = pace.now() + 3600 * SECOND
        threading.Timer(0.02, lambda: setattr(stop, "value", 1)).start()
        assert pace.wait(deadline, 0, stop) < deadline
    finally:
        over.set()
        thread.join()  # a signal that comes later would end the process
        signal.signal(signal.SIGALRM, old)


def test_clocks_of_python() -> None:
    assert abs(clock.realtime_ns() * 1e-9 - clock.wall_time()) < 60
    start = clock.monotonic_ns()
    clock.sleep(0)
    clock.sleep(-1)
    clock.sleep(0.001)
    assert clock.monotonic_ns() - start >= 1_000_000
