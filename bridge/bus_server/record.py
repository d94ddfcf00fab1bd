"""The last seconds of a simulated channel: an account, and a picture."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from cosim.bus.accounting import BusHistory
from cosim.bus.frames import EVENT, REQUEST, BusFrame
from cosim.bus.timing import BusTiming
from cosim.reporting.bus_account import account_lines, draw_account

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

    def _history(self, timing: BusTiming) -> BusHistory:
        """Requests and events, renumbered from 0."""
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
        return BusHistory(timing, tuple(self.names), rows, events)

    def lines(self, timing: BusTiming) -> Iterator[str]:
        """The account as text."""
        begin = max(0, self._until - KEPT_PS)
        return account_lines(self._history(timing), begin, self._until)

    def draw(self, path: Path, timing: BusTiming, window_ps: int) -> Path:
        """The picture of the last `window_ps` (ps). Raises RunError."""
        begin = max(0, self._until - window_ps)
        return draw_account(path, self._history(timing), begin, self._until)
