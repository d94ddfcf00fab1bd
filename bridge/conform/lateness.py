"""Lateness of the kit itself: of its frames, its threads, and the buses between it and itself."""

from __future__ import annotations

import threading
from bisect import bisect_left
from typing import final

from cosim.base.clock import monotonic_ns

#: The time between two looks of the probe, and the lateness that is not kept, ns.
PROBE_NS, LEAST_NS = 5_000_000, 200_000


@final
class KitLateness:
    """Times (monotonic, ns) at which something of the kit was late, and by how much.

    A thread measures in addition how late a process of this machine is woken.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._at: list[int] = []
        self._late: list[int] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._probe, name="lateness", daemon=True)
        self._thread.start()

    def add(self, at_ns: int, late_ns: int) -> None:
        """Something that was due `late_ns` before `at_ns`."""
        if late_ns < LEAST_NS:
            return
        with self._lock:
            self._at.append(at_ns)
            self._late.append(late_ns)

    def worst_ns(self, since_ns: int) -> int:
        """The largest lateness since then, ns."""
        with self._lock:
            first = max(0, bisect_left(self._at, since_ns) - 8)  # threads append nearly in order
            found = zip(self._at[first:], self._late[first:], strict=True)
            return max((late for at, late in found if at >= since_ns), default=0)

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join()

    def _probe(self) -> None:
        due_ns = monotonic_ns() + PROBE_NS
        while not self._stop.wait(max(0, due_ns - monotonic_ns()) / 1e9):
            now_ns = monotonic_ns()
            self.add(now_ns, now_ns - due_ns)
            due_ns = max(due_ns + PROBE_NS, now_ns)
