"""What happened on a simulated channel in its last seconds: an account, and a picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from cosim.bus.accounting import accounts, losses, waits
from cosim.bus.frames import EVENT, REQUEST, BusEvent, BusFrame, ControllerState
from cosim.bus.timing import BusTiming
from cosim.bus.transmissions import busy_share, transmissions
from cosim.reporting.bus_timeline import draw_timeline

KEPT_PS = 10**13
"""How much of the past is kept, ps."""


@final
class BusRecord:
    """Events and requests of a channel whose nodes come and go, numbered as of one bus."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._events: deque[NDArray[np.void]] = deque()
        self._requests: dict[int, tuple[int, int, BusFrame]] = {}
        self._until = 0

    def node(self, name: str) -> int:
        """The number of a node that has joined."""
        self.names.append(name)
        return len(self.names) - 1

    def request(self, number: int, at_ps: int, node: int, frame: BusFrame) -> None:
        """A request; numbers rise."""
        self._requests[number] = (at_ps, node, frame)

    def add(self, events: NDArray[np.void], until_ps: int) -> None:
        """Events, shape (n,), up to `until_ps` (ps), with the numbers of this record."""
        self._until = until_ps
        if len(events):
            self._events.append(events)
        while self._events and self._events[0]["time"][-1] < until_ps - KEPT_PS:
            self._events.popleft()
        if len(self._requests) > 200_000:
            old = [n for n, (at, *_) in self._requests.items() if at < until_ps - KEPT_PS]
            for number in old:
                del self._requests[number]

    def _tables(self) -> tuple[NDArray[np.void], NDArray[np.void]]:
        """(requests, events), renumbered from 0."""
        events = np.concatenate([np.empty(0, EVENT), *self._events])
        numbers = np.array(list(self._requests), np.int64)
        rows = np.zeros(len(numbers), REQUEST)
        for i, (at, node, frame) in enumerate(self._requests.values()):
            rows[i] = (at, node, 0, frame.row())
        events = events.copy()
        if len(numbers):
            place = np.searchsorted(numbers, events["request"])
            place = np.minimum(place, len(numbers) - 1)
            known = numbers[place] == events["request"]
            events["request"] = np.where(known, place, -1)
        return rows, events

    def lines(self, timing: BusTiming) -> Iterator[str]:
        """The account as text."""
        rows, events = self._tables()
        begin = max(0, self._until - KEPT_PS)
        busy = transmissions(events, timing, self._until)
        if self._until <= begin:
            yield "no time has passed"
            return
        share = busy_share(busy, begin, self._until, self._until - begin)[0]
        windows = busy_share(busy, begin, self._until, min(10**11, self._until - begin))[:, 0]
        yield (
            f"{(self._until - begin) / 1e12:.3f} s: load {share[0]:.1%}, of that {share[1]:.1%} by "
            f"failed attempts; highest in 0.1 s {windows.max():.1%}"
        )
        if len(rows):
            yield from _identifiers(rows, events)
        for loss in losses(rows, events, busy)[:10] if len(rows) else ():
            by = max(loss.blocked_by, key=lambda n: loss.blocked_by[n], default=-1)
            who = f"; the bus had mostly {self.names[by]}" if by >= 0 else ""
            where = f"{loss.cause.name} at {self.names[loss.node]}"
            yield f"lost at {loss.time_ps / 1e12:.6f} s: {where}{who}"
        off = events[(events["kind"] == BusEvent.STATE) & (events["code"] == ControllerState.OFF)]
        for row in off[:10]:
            yield f"bus-off at {row['time'] / 1e12:.6f} s: {self.names[row['node']]}"

    def draw(self, path: Path, timing: BusTiming, window_ps: int) -> Path:
        """The picture of the last `window_ps` (ps). Raises RunError."""
        rows, events = self._tables()
        busy = transmissions(events, timing, self._until)
        labels = {i: f"{row['frame']['id']:X}" for i, row in enumerate(rows)}
        begin = max(0, self._until - window_ps)
        waiting = [w for w in waits(rows, events) if w[2] > begin]
        return draw_timeline(
            path, busy, self.names, begin, self._until, labels=labels, waiting=waiting
        )


def _identifiers(rows: NDArray[np.void], events: NDArray[np.void]) -> Iterator[str]:
    yield "identifier    sent  failed  lost   mean     99 %    worst   response time, ms"
    for a in accounts(rows, events):
        name = f"{a.identifier:08X}" if a.extended else f"{a.identifier:03X}"
        ms = [t / 1e9 for t in (a.mean, a.quantile(0.99), a.worst)]
        lost = sum(a.lost.values())
        yield (
            f"{name:<10} {a.sent:>7} {a.errors:>7} {lost:>5} "
            f"{ms[0]:>8.3f} {ms[1]:>8.3f} {ms[2]:>8.3f}"
        )
