"""The simulated time of channels whose clients are whole programs in bus time.

Time passes when every thread of every program waits (`program_table`) and the server has answered
all calls. Then those that can continue do so one after the other: first clients of the bus that
have an answer, then the threads, by program and by number.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from bridge.bus_server.attention import Attention
from bridge.bus_server.can_sockets import CanSockets
from bridge.bus_server.program_table import ProgramTable
from bridge.simulated_can.pace import Paced
from bridge.simulated_can.shared_time import SharedTime

_LOOK_NS = 20_000_000
"""Wall time for which one step waits for the programs, ns."""
_PAUSE = 0.001
"""Wall time for which one step waits for the threads of the server, s."""


@dataclass(eq=False, slots=True)
class _Call:
    """A call of a client that waits."""

    ready: Callable[[], bool]
    until_ps: int | None

    def is_due(self, now_ps: int) -> bool:
        return self.ready() or (self.until_ps is not None and now_ps >= self.until_ps)


@final
class ProgramPace:
    """Lets calls wait until :class:`ProgramTime` brings the channel to their end.

    `epoch`: CLOCK_REALTIME of the programs at time 0, s; time stamps count from it.
    """

    def __init__(self, table: ProgramTable, epoch: float) -> None:
        self.epoch = epoch
        self.calls: dict[int, _Call] = {}
        self._table = table

    def catch_up(self, channel: Paced) -> None:
        """Bring the channel to the time of the thread that calls, and keep it there."""
        self._table.revoke()
        channel.advance(max(channel.now_ps, self._table.now_ns * 1000))

    def wait(
        self, channel: Paced, ready: Callable[[], bool], timeout: float | None, quit_ps: int | None
    ) -> bool:
        """`timeout` is in seconds of the channel."""
        self.catch_up(channel)
        if ready() or (timeout is not None and timeout <= 0):
            return ready()
        later = None if timeout is None else channel.now_ps + round(timeout * 1e12)
        ends = [t for t in (later, quit_ps) if t is not None]
        call = _Call(ready, min(ends) if ends else None)
        self.calls[threading.get_ident()] = call
        self._table.ring()
        try:
            while not call.is_due(channel.now_ps):
                channel.lock.wait()
            return ready()
        finally:
            del self.calls[threading.get_ident()]
            channel.lock.notify_all()


@final
class ProgramTime:
    """Time of the programs of `table`, and of all channels that join `shared`."""

    def __init__(self, table: ProgramTable, epoch: float) -> None:
        self.table = table
        self.attention = Attention()
        self.sockets: CanSockets | None = None
        """Sockets of AF_CAN that the programs have opened."""
        self._epoch_ns = round(epoch * 1e9)
        self._pace = ProgramPace(table, epoch)
        self.shared = SharedTime(self._pace)

    def step(self, end_ps: int | None, is_over: Callable[[], bool] = lambda: False) -> bool:
        """Let one thread go on, or time pass to what happens next, `end_ps` (ps) at most.

        False if that cannot be: a thread does not wait, nothing will happen, or `is_over`, which
        is asked when all threads wait, so that the end has an exact time.
        """
        answered = self.attention.answered
        if not self.table.settle(_LOOK_NS) or is_over():
            return False
        with self.shared.lock:
            if answered != self.attention.answered or self.attention.is_due(self._pace.calls):
                self.shared.lock.wait(_PAUSE)
                return True
            self.shared.advance(max(self.shared.now_ps, self.table.now_ns * 1000))
            if any(call.is_due(self.shared.now_ps) for call in self._pace.calls.values()):
                self.shared.lock.notify_all()
                self.shared.lock.wait(_PAUSE)
                return True
            now_ns = self.shared.now_ps // 1000
            if self.sockets is not None and self.sockets.serve(now_ns, self._epoch_ns):
                return True
            return self._go_on(end_ps)

    def _go_on(self, end_ps: int | None) -> bool:
        found = [self.shared.next_ps(), end_ps, *(c.until_ps for c in self._pace.calls.values())]
        timer_ns = None if self.sockets is None else self.sockets.next_ns()
        found.append(None if timer_ns is None else timer_ns * 1000)
        happening = min((t for t in found if t is not None), default=None)
        place = self.table.next()
        if place is not None:
            self.table.grant(place, None if happening is None else happening // 1000)
            return True
        earliest_ns = self.table.earliest_ns()
        ends = [happening, None if earliest_ns is None else earliest_ns * 1000]
        target = min((t for t in ends if t is not None), default=None)
        if target is None or (end_ps is not None and self.shared.now_ps >= end_ps):
            return False
        self.shared.advance(target)
        self.table.advance(target // 1000)
        return True
