"""Further threads for the engine: they take blocks of operations while a chunk of ticks runs.

The threads are Python's; what they do is ``engine_work`` in C, without the interpreter. A segment
is shared if it has many blocks that do not depend on each other, all of FMUs or native components.
Every signal is computed by the same instructions, whichever thread does it: the results are the
same to the bit for any number of threads.
"""

from __future__ import annotations

import ctypes as c
import threading
from collections.abc import Mapping
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from cosim.engine.binding import Binding
from cosim.native import structs
from cosim.native.structs import UnitKind
from cosim.schedule.plan import Plan

#: How the threads are called, with a number.
NAME = "engine thread"
#: Blocks from which on it is worth to share a segment.
LEAST = 32
#: What may be stepped by any thread: it does not call Python, and has no solver of its own.
SHARED_KINDS = frozenset({UnitKind.NATIVE, UnitKind.FMI2, UnitKind.FMI3})


class Team:
    """`threads` threads for a bound plan, the calling one among them; a context manager.

    `shares`: whether there is any segment for them.
    """

    def __init__(self, plan: Plan, bound: Binding, threads: int) -> None:
        self._plan, self._bound, self._threads = plan, bound, threads
        none = structs.FailureStruct(operation=-1)
        self._members = (structs.MemberStruct * threads)(
            *(structs.MemberStruct(failed=none, ended=none) for _ in range(threads))
        )
        self._team = structs.TeamStruct(members=c.addressof(self._members), threads=threads, quit=1)
        self._able = [i for i, s in enumerate(plan.segments) if self._can_share(i)]
        for i in self._able:
            bound.segments[i].shared = 1
        self.shares = bool(self._able)
        self._go = [threading.Semaphore(0) for _ in range(threads - 1)]
        self._done = threading.Semaphore(0)
        self._ending = False
        self._running: list[threading.Thread] = []

    def _can_share(self, index: int) -> bool:
        segment = self._plan.segments[index]
        units = {
            o.index for o in self._plan.operations[segment.first : segment.last]
            if o.code == structs.Code.STEP
        }  # fmt: skip
        kinds = {UnitKind(self._bound.units[i].kind) for i in units}
        many = len(segment.blocks) > LEAST
        return many and segment.independent and kinds <= SHARED_KINDS

    def allow(self, rows: Mapping[str, NDArray[np.int32]], tick: int) -> None:
        """Share segments whose links take at least a tick in the next rows of their tables.

        `rows` (n,): by link, the samples held; `tick`: of the first of them or before.
        """
        for i in self._able:
            links = self._plan.segments[i].links
            filled = not (links and self._plan.buses)  # else tables are made while they run
            late = filled and all(self._is_late(link, rows, tick) for link in links)
            self._bound.segments[i].shared = int(late)

    def _is_late(self, index: int, rows: Mapping[str, NDArray[np.int32]], tick: int) -> bool:
        link = self._plan.links[index]
        grid = link.table.grid
        held = rows[link.name].astype(np.int64)
        looks = (-(-tick // grid.n_r) + np.arange(held.size)) * grid.n_r
        return bool((held * grid.n_s < looks).all())

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
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        """Wait until all have stopped."""
        self._team.quit = 1
        for _ in self._running:
            self._done.acquire()
        self._bound.state.team = None

    def _work(self, number: int) -> None:
        library, state = structs.library(), self._bound.state
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
