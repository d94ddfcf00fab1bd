"""Buses that cannot keep to the wall clock are noticed, however they are kept from it."""

from __future__ import annotations

import threading

from bridge.bus_server.lag import APART_NS, LEAST_NS, PERIOD_NS, BusLag, LagWatch


class Slow:
    """A bus that is brought to the present when `free` is set, or at once from then on."""

    def __init__(self) -> None:
        self.free, self.asked, self.again = (threading.Event() for _ in range(3))

    def catch_up(self) -> None:
        if self.asked.is_set():
            self.again.set()
        self.asked.set()
        assert self.free.wait(30)


def test_a_bus_that_takes_long_is_late_by_that() -> None:
    bus, lags = Slow(), list[BusLag]()
    watch = LagWatch({"left": bus}, lags)
    assert bus.asked.wait(30)
    threading.Event().wait(3 * LEAST_NS / 1e9)
    bus.free.set()
    assert bus.again.wait(30)
    watch.close()
    assert lags[0].bus == "left" and lags[0].lag_ns >= 3 * LEAST_NS
    assert lags[0].end_ns - lags[0].begin_ns >= lags[0].lag_ns


def test_lags_soon_after_each_other_are_one_and_short_ones_are_none() -> None:
    lags: list[BusLag] = []
    watch = LagWatch({}, lags)
    watch.close()
    for begin, lag in (
        (0, LEAST_NS - 1), (PERIOD_NS, LEAST_NS), (PERIOD_NS + LEAST_NS + APART_NS, 2 * LEAST_NS),
        (3 * APART_NS, LEAST_NS),
    ):  # fmt: skip
        watch._keep("left", begin, begin + lag)
    first, second = lags
    assert (first.begin_ns, first.end_ns, first.lag_ns) == (
        PERIOD_NS, PERIOD_NS + 3 * LEAST_NS + APART_NS, 2 * LEAST_NS,
    )  # fmt: skip
    assert (second.begin_ns, second.lag_ns) == (3 * APART_NS, LEAST_NS)
