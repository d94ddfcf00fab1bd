"""A path whose data come by a call-back on another thread: Zenoh, and buses of python-can."""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from typing import final

from bridge.ping.exchanges import Arrival
from cosim.base.clock import monotonic_ns
from cosim.base.queues import take


@final
class QueuedPath:
    """`put` is the call-back: data, their arrival (ns), and where an answer goes to."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Arrival] = queue.SimpleQueue()
        self.sender: Callable[[bytes, object], None] = _nowhere

    def put(self, data: bytes, t_ns: int, sender: object = None) -> None:
        """Something arrived."""
        self._queue.put(Arrival(data, t_ns, 0, sender))

    def send(self, data: bytes, to: object = None) -> None:
        """Send by `sender`."""
        self.sender(data, to)

    def receive(self, until_ns: int) -> Sequence[Arrival]:
        """The first arrivals, at the latest at `until_ns`; `wake_ns`: its time in the queue."""
        try:
            first = take(self._queue, (until_ns - monotonic_ns()) * 1e-9)
        except queue.Empty:
            return []
        return [first._replace(wake_ns=max(0, monotonic_ns() - first.t_ns))]

    def close(self) -> None:
        """Nothing to close: who calls back is closed by who opened it."""


def _nowhere(data: bytes, to: object) -> None:
    """Before there is somewhere to send to."""
