"""Parts of a plan run apart, by one or more threads (``partitions.c``).

Parts reach each other over links only. What a part needs of the others is older than the least
delay of these links; for so many ticks, a window, each can run alone. If wires connect too much, a
window is one tick in two stages. Every signal is computed by the same instructions on the same
values: the results are the same to the bit for any number of threads, and as without parts. The
threads are Python's; what they do is ``engine_work`` in C, without the interpreter.
"""

from __future__ import annotations

import ctypes as c
import threading
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from cosim.engine.binding import WINDOW, Binding
from cosim.engine.bulk_steps import stride
from cosim.engine.tables import LinkRows
from cosim.links.semantics import Grid
from cosim.native import shared, structs
from cosim.native.enums import Code

#: How the threads are called, with a number.
NAME = "engine thread"
#: Ticks of a window that need not be longer: the rows are not searched for it.
ENOUGH = 16


class Team:
    """`threads` threads for a plan bound in parts, the calling one among them.

    `start`: the tick of the first rows of tables. `window`: for how many ticks the parts can run
    apart, 0: not at all, until the next :meth:`allow`. A context manager around ``engine_run``.
    """

    def __init__(self, bound: Binding, threads: int, start: int) -> None:
        parts, divided = bound.partition, bound.divided
        assert parts is not None and divided is not None
        self._bound, self._threads, self._start = bound, threads, start
        least = {i: bound.plan.links[i].table.minimum_delay_ticks for i in parts.links}
        self._least = min((x for x in least.values() if x >= ENOUGH), default=WINDOW)
        self._short = {i: bound.plan.links[i].table.grid for i, x in least.items() if x < ENOUGH}
        none = structs.FailureStruct(operation=-1)
        self._members = (structs.MemberStruct * threads)(
            *(structs.MemberStruct(failed=none, ended=none) for _ in range(threads))
        )
        operations = bound.plan.operations
        self._places = np.ascontiguousarray(parts.operations[1], dtype=np.int64)
        self._team = structs.TeamStruct(
            parts=divided.parts.ctypes.data, n_parts=parts.count, n_plan=len(operations),
            places=self._places.ctypes.data, members=c.addressof(self._members), threads=threads,
            record=next(i for i, op in enumerate(operations) if op.code == Code.RECORD),
            first=int(bound.together), longest=WINDOW, quit=1, staged=parts.second is not None,
            stride=stride(bound),
        )  # fmt: skip
        self._go = [threading.Semaphore(0) for _ in range(threads - 1)]
        self._done = threading.Semaphore(0)
        self._ending = False
        self._running: list[threading.Thread] = []

    @property
    def window(self) -> int:
        """Ticks for which parts run apart, at most."""
        return int(self._team.longest)

    def allow(self, drawn: LinkRows, tick: int) -> None:
        """Make windows as long as the least delay in the next rows of the links' tables, or long
        enough.

        `tick`: of the first rows or before.
        """
        longest = min(WINDOW, self._least)
        if self._short:
            parts = drawn.parts()
            ages = (_least(grid, parts[i], tick - self._start) for i, grid in self._short.items())
            longest = min(longest, *ages)
        self._team.longest = longest

    def __enter__(self) -> Team:
        """Let the others begin, for one call of ``engine_run``."""
        if not self._running:
            self._running = [
                threading.Thread(target=self._work, args=(k,), name=f"{NAME} {k}", daemon=True)
                for k in range(1, self._threads)
            ]
            for thread in self._running:
                thread.start()
        self._team.quit = 0
        self._bound.state.team = c.addressof(self._team)
        for go in self._go:
            go.release()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait until all have stopped."""
        self._team.quit = 1
        for _ in self._running:
            self._done.acquire()
        self._bound.state.team = None

    def _work(self, number: int) -> None:
        library, state = shared.library(), self._bound.state
        while True:
            self._go[number - 1].acquire()
            if self._ending:
                return
            library.engine_work(c.byref(state), number)
            self._done.release()

    def close(self) -> None:
        """End the threads."""
        self._ending = True
        for go in self._go:
            go.release()
        for thread in self._running:
            thread.join()
        self._running = []


def _least(grid: Grid, held: NDArray[np.int32], tick: int) -> int:
    """The least age of a sample in these rows, up to a window."""
    first = -(-tick // grid.n_r) * grid.n_r
    looks = np.arange(first, first + held.size * grid.n_r, grid.n_r)
    ages = (looks - held.astype(np.int64) * grid.n_s)[held >= 0]
    return min(WINDOW, int(ages.min(initial=WINDOW)))
