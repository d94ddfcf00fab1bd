"""Measurement of how far simulated buses are behind the wall clock, which they have to keep."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, final

from cosim.base.clock import monotonic_ns

#: The time between two looks at the buses, the least lag that is kept, and the time between two
#: lags below which they are one, ns.
PERIOD_NS, LEAST_NS, APART_NS = 10_000_000, 20_000_000, 1_000_000_000


class OnWallClock(Protocol):
    """A bus that keeps to the wall clock."""

    def catch_up(self) -> None:
        """Bring the bus to the present."""


@dataclass(slots=True)
class BusLag:
    """The time in which a bus was behind the wall clock: monotonic ns, and the largest lag, ns."""

    bus: str
    begin_ns: int
    end_ns: int
    lag_ns: int


@final
class LagWatch:
    """A thread that brings buses to the present every PERIOD_NS; the lag is its delay in that.

    So a process that stands still, a bus whose frames take longer to simulate than on the wire, and
    a lock that is held for too long all show. `lags` is appended to.
    """

    def __init__(self, buses: Mapping[str, OnWallClock], lags: list[BusLag]) -> None:
        self._buses, self._lags = buses, lags
        self._last: dict[str, BusLag] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="bus lag", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        due_ns = monotonic_ns() + PERIOD_NS
        while not self._stop.wait(max(0, due_ns - monotonic_ns()) / 1e9):
            for name, bus in self._buses.items():
                bus.catch_up()
                self._keep(name, due_ns, monotonic_ns())
            due_ns = max(due_ns + PERIOD_NS, monotonic_ns())

    def _keep(self, name: str, due_ns: int, done_ns: int) -> None:
        """Keep a lag; one soon after another is one with it."""
        if done_ns - due_ns < LEAST_NS:
            return
        last = self._last.get(name)
        if last is None or due_ns - last.end_ns > APART_NS:
            self._last[name] = BusLag(name, due_ns, done_ns, done_ns - due_ns)
            self._lags.append(self._last[name])
        else:
            last.end_ns, last.lag_ns = done_ns, max(last.lag_ns, done_ns - due_ns)
