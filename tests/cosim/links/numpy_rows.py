"""The rows of links' tables in NumPy, vectorised, and of queues with ``deque`` and ``heapq``: what
``tables.c`` must equal to the bit.
"""

from __future__ import annotations

from collections import deque
from heapq import heappop, heappush
from math import isfinite

import numpy as np

from cosim.links.semantics import TOLERANCE, PacketSemantics, PlayoutSemantics, QueueSemantics
from cosim.links.table import DrawnTable


def rows_of(table: DrawnTable):
    """The rows of a table from the first on; ``take(n)`` returns the next n of them, (n,)."""
    delays, grid, rule = table.delays(), table.grid, table.rule
    if isinstance(rule, PacketSemantics):
        return _PacketRows(delays, grid, rule.order)
    if isinstance(rule, PlayoutSemantics):
        return _PlayoutRows(delays, grid, grid.ticks(rule.buffer))
    if isinstance(rule, QueueSemantics):
        return _QueueRows(delays, grid, rule)
    return _SignalRows(delays, grid)


class _SignalRows:
    def __init__(self, delays, grid):
        self._delays, self._grid, self._row = delays, grid, 0

    def take(self, n):
        n_s, n_r, row = self._grid.n_s, self._grid.n_r, self._row
        self._row += n
        T = self._delays.take(n)
        back = np.floor(T / self._grid.h + (0.5 * n_s + TOLERANCE)).astype(np.int64)
        if n_r % n_s == 0:  # the receiver reads when the sender sends
            ratio = n_r // n_s
            j = np.arange(ratio * row, ratio * (row + n), ratio, dtype=np.int64)
            j -= back // n_s
        else:
            K = n_r * np.arange(row, row + n, dtype=np.int64)
            j = np.minimum(-((back - K) // n_s), K // n_s)  # ceil(j/n_s), if it has been sent
        return np.maximum(j, -1, out=j)


class _PacketRows:
    """Carry: packets still on their way, and what is held."""

    def __init__(self, delays, grid, order):
        self._delays, self._grid, self._order = delays, grid, order
        self._row, self._held = 0, -1
        self._sent = 0  # packets sent so far
        self._arrived = 0  # tick in which the last packet arrives (fifo)
        self._arrival = np.empty(0, np.int64)  # (on the way,), ticks
        self._index = np.empty(0, np.int64)  # (on the way,), ascending

    def take(self, n):
        if n == 0:
            return np.empty(0, np.int64)
        n_r, row = self._grid.n_r, self._row
        arrival, index = self._due(n_r * (row + n - 1))
        self._row += n
        look = -(-arrival // n_r) - row  # the first look that sees it, relative to `row`
        if self._order == "last-arrival":
            rows = _hold(_last(look, arrival - n_r * (row + look), index, n), self._held)
        else:
            rows = np.full(n, self._held, np.int64)
            np.maximum.at(rows, look, index)
            np.maximum.accumulate(rows, out=rows)
        self._held = int(rows[-1])
        return rows

    def _due(self, K):
        """Arrival ticks and indices of the packets that arrive up to tick K and did not before."""
        index = np.arange(self._sent, K // self._grid.n_s + 1, dtype=np.int64)
        self._sent += index.size
        T = self._delays.take(index.size)
        arrives = np.isfinite(T)
        if not arrives.all():
            index, T = index[arrives], T[arrives]
        arrival = self._grid.n_s * index + _ticks_up(T, self._grid).astype(np.int64)
        if self._order == "fifo" and index.size:
            np.maximum.accumulate(arrival, out=arrival)
            np.maximum(arrival, self._arrived, out=arrival)
            self._arrived = int(arrival[-1])
        arrival = np.concatenate((self._arrival, arrival))
        index = np.concatenate((self._index, index))
        due = arrival <= K
        self._arrival, self._index = arrival[~due], index[~due]
        return arrival[due], index[due]


def _last(look, tick, index, n):
    """The last arrival for each of `n` looks, by (tick, index); -1 where nothing arrived.

    `tick` (packets,) is relative to the look, in (-n_r, 0].
    """
    key = np.full(n, -1, np.int64)
    np.maximum.at(key, look, (tick + 2**31 - 1 << 32) + index)
    return np.where(key >= 0, key & 0xFFFFFFFF, -1)


def _hold(fresh, held):
    """`fresh` (n,), each -1 replaced by what was there before it; `held`: before the first."""
    if fresh[0] < 0:
        fresh[0] = held
    source = np.where(fresh >= 0, np.arange(fresh.size), 0)
    rows = fresh[np.maximum.accumulate(source)]
    return rows


class _PlayoutRows:
    """Carry: the delay of the sample being played, and what is held."""

    def __init__(self, delays, grid, buffer):
        self._delays, self._grid, self._buffer = delays, grid, buffer
        self._row, self._held = 0, -1
        self._first = 0  # sample whose delay stands first in `_T`
        self._T = np.empty(0)  # (samples,), s

    def take(self, n):
        if n == 0:
            return np.empty(0, np.int64)
        n_s, n_r = self._grid.n_s, self._grid.n_r
        K = n_r * np.arange(self._row, self._row + n, dtype=np.int64)
        self._row += n
        j = (K - self._buffer) // n_s  # (n,), to be played
        last = int(j[-1])
        if last < 0:
            return np.full(n, -1, np.int64)
        missing = last + 1 - self._first - self._T.size
        T = np.concatenate((self._T, self._delays.take(missing)))
        late = _ticks_up(T, self._grid)[
            np.maximum(j, 0) - self._first
        ]  # (n,), ticks; lost: nan, inf
        in_time = (j >= 0) & (late <= K - n_s * j)
        rows = _hold(np.where(in_time, j, -1), self._held)
        self._first, self._T, self._held = last, T[-1:], int(rows[-1])
        return rows


class _QueueRows:
    """Carry: packets on their way by arrival, the queue, and what is held."""

    def __init__(self, delays, grid, rule):
        self._delays, self._grid, self._rule = delays, grid, rule
        self._queue = Queue(rule)
        self._row, self._sent, self._coming = 0, 0, []

    def take(self, n):
        grid, rows = self._grid, []
        for K in range(grid.n_r * self._row, grid.n_r * (self._row + n), grid.n_r):
            count = K // grid.n_s + 1 - self._sent
            for T in self._delays.take(count):
                if isfinite(T):
                    arrival = grid.n_s * self._sent + int(_ticks_up(T, grid))
                    heappush(self._coming, (arrival, self._sent))
                self._sent += 1
            while self._coming and self._coming[0][0] <= K:
                self._queue.put(heappop(self._coming)[1])
            rows.append(self._queue.get())
        self._row += n
        return np.array(rows, np.int64)


class Queue:
    """A receiver that takes from a ``deque``; what it holds."""

    def __init__(self, rule):
        self._rule, self.held = rule, -1
        self._waiting = deque(maxlen=rule.depth if rule.drop == "oldest" else None)

    def put(self, sample):
        if self._rule.drop == "oldest" or len(self._waiting) < self._rule.depth:
            self._waiting.append(sample)

    def get(self):
        if self._waiting and self._rule.take == "one":
            self.held = self._waiting.popleft()
        elif self._waiting:
            self.held = self._waiting.pop()
            self._waiting.clear()
        return self.held


def _ticks_up(T, grid):
    """ceil(T/h), to 1e-9 tick; not finite where T is not."""
    return np.ceil(T / grid.h - TOLERANCE)
