"""Progress of a simulated channel's time: with the wall clock, or while all threads wait."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, final

from cosim.base.clock import monotonic_ns, realtime_ns

PATIENCE_NS = 20_000_000
"""How long, in wall time, the others wait for a thread that is not in a call of the channel."""
_LEAST_WAIT = 5e-5
#: One step of catching up, ps of the channel, and how long a call catches up at most, ns.
_STEP_PS, _LONGEST_NS = 10_000_000_000, 250_000_000


class Participant(Protocol):
    """Whom simulated time waits for: a thread, of this process or (bus_server) of another."""

    def is_alive(self) -> bool:
        """True if it can still use the channel."""


_acting = threading.local()


def act_as(participant: Participant) -> None:
    """Let what this thread does from now on count as done by `participant`."""
    _acting.who = participant


def _who() -> Participant:
    try:
        found: Participant = _acting.who
    except AttributeError:
        found = _acting.who = threading.current_thread()
    return found


@final
class ChannelLock(threading.Condition):
    """The lock of a channel, and the wait for what others change there.

    In the way of each message: to hold `held` is to hold the lock, and to tell of a change costs
    nothing while no thread waits.
    """

    def __init__(self) -> None:
        self.held = threading.RLock()
        super().__init__(self.held)
        self._sleepers = 0

    def wait(self, timeout: float | None = None) -> bool:
        """Wait to be told, for up to `timeout` (s); false when that is over."""
        self._sleepers += 1
        try:
            return super().wait(timeout)
        finally:
            self._sleepers -= 1

    def notify_all(self) -> None:
        """Wake all threads that wait."""
        if self._sleepers:
            super().notify_all()


class Paced(Protocol):
    """A channel, as its pace sees it. Times are ps of the channel; `lock` is held."""

    lock: ChannelLock

    @property
    def now_ps(self) -> int:
        """The time of the channel, ps."""

    def next_ps(self) -> int | None:
        """The next time at which something may happen; None: never, by itself."""

    def advance(self, until_ps: int) -> None:
        """Go on, and hand out what arrives."""


class BusPace(Protocol):
    """Decides where the time of a channel is. All calls hold the lock of the channel."""

    @property
    def epoch(self) -> float:
        """The offset of time stamps from the time of the channel, s."""

    def catch_up(self, channel: Paced) -> None:
        """Bring the channel to where it has to be now."""

    def wait(
        self, channel: Paced, ready: Callable[[], bool], timeout: float | None, quit_ps: int | None
    ) -> bool:
        """Wait until `ready`; False after `timeout` (s), or at the time `quit_ps` (ps)."""


@final
class WallPace:
    """The channel goes `speed` times as fast as the wall clock.

    No thread drives it: each call brings the channel to the present, and a call that waits sleeps
    until something may happen. Frames have their exact times all the same. On a machine that is too
    slow for the traffic, the channel stays behind, and calls return all the same.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start_ns = monotonic_ns()
        self.epoch = realtime_ns() / 1e9

    def catch_up(self, channel: Paced) -> None:
        """Advance to the present, or as far as possible in a quarter of a second."""
        began_ns = monotonic_ns()
        present = int((began_ns - self._start_ns) * 1000 * self._speed)
        while channel.now_ps + _STEP_PS < present:
            channel.advance(channel.now_ps + _STEP_PS)
            if monotonic_ns() - began_ns > _LONGEST_NS:
                return
        channel.advance(max(channel.now_ps, present))

    def wait(
        self, channel: Paced, ready: Callable[[], bool], timeout: float | None, quit_ps: int | None
    ) -> bool:
        """`timeout` is in seconds of the channel. What is awaited until `quit_ps` is time.

        What is there already needs no catching up, which may take longer than the time it makes up.
        """
        if quit_ps is None and ready():
            return True
        end_ns = None if timeout is None else monotonic_ns() + int(timeout * 1e9 / self._speed)
        while True:
            self.catch_up(channel)
            if ready():
                return True
            left = None if end_ns is None else (end_ns - monotonic_ns()) / 1e9
            if (left is not None and left <= 0) or _reached(channel, quit_ps):
                return False
            ends = [t for t in (channel.next_ps(), quit_ps) if t is not None]
            ends = ends if quit_ps is None else [quit_ps]
            waits = [(t - channel.now_ps) / 1e12 / self._speed for t in ends]
            waits += [] if left is None else [left]
            channel.lock.wait(max(min(waits), _LEAST_WAIT) if waits else None)


@dataclass(eq=False, slots=True)
class _Waiter:
    """A thread in a call that waits."""

    ready: Callable[[], bool]
    until_ps: int | None
    end_ns: int | None
    """When it ends by the wall clock, while a thread is away."""
    sleeps: bool
    """The time of the channel at its end matters, not only that it ends."""

    def is_due(self, channel: Paced) -> bool:
        """True if its call returns now; it has only to wake."""
        return self.ready() or _reached(channel, self.until_ps)


@final
class SimulatedPace:
    """Time stands while a thread that uses the channel does something else than wait in it.

    When all wait, it moves to what happens next: a frame, a periodic message, the end of a
    time-out. When a thread has been away for longer than PATIENCE_NS of wall time, the others go
    on without it, but only to frames and periodic messages; time-outs and sleeps then end in wall
    time. A call with time-out 0 does not move time. With `strict`, the others wait for it as long
    as it lives.
    """

    epoch = 0.0

    def __init__(self, strict: bool = False) -> None:
        self._strict = strict
        self._seen: dict[Participant, int] = {}
        self._waiters: dict[Participant, _Waiter] = {}

    def catch_up(self, channel: Paced) -> None:
        """Note that this thread uses the channel; time stays where it is."""
        self._seen[_who()] = monotonic_ns()

    def wait(
        self, channel: Paced, ready: Callable[[], bool], timeout: float | None, quit_ps: int | None
    ) -> bool:
        """`timeout` is in seconds of the channel; of the wall clock while a thread is away."""
        thread = _who()
        self._seen[thread] = now_ns = monotonic_ns()
        if ready():
            return True
        if timeout is not None and timeout <= 0:
            return False
        until_ps = None if timeout is None else channel.now_ps + round(timeout * 1e12)
        until_ps = earlier(quit_ps, until_ps)
        if len(self._seen) == 1 and _move_alone(channel, ready, until_ps):
            self._seen[thread] = monotonic_ns()
            return ready()
        end_ns = None if timeout is None else now_ns + int(timeout * 1e9)
        if quit_ps is not None:
            end_ns = now_ns + (quit_ps - channel.now_ps) // 1000
        waiter = _Waiter(ready, until_ps, end_ns, quit_ps is not None)
        self._waiters[thread] = waiter
        try:
            while not ready():
                patience = self._missing()
                absent = patience is not None and patience <= 0
                over = absent and not waiter.sleeps and _passed(end_ns)
                if over or _reached(channel, until_ps):
                    return False
                self._move(channel, patience, end_ns)
            return True
        finally:
            del self._waiters[thread]
            self._seen[thread] = monotonic_ns()
            channel.lock.notify_all()

    def _move(self, channel: Paced, patience: int | None, end_ns: int | None) -> None:
        """Advance if no thread is busy, else sleep until something may have changed."""
        alone = len(self._waiters) == 1
        if not alone and any(waiter.is_due(channel) for waiter in self._waiters.values()):
            patience = PATIENCE_NS
        target = None
        if patience is None or patience <= 0:
            target = channel.next_ps()
            for waiter in self._waiters.values():
                if patience is None or (waiter.sleeps and _passed(waiter.end_ns)):
                    target = earlier(target, waiter.until_ps)
        if target is not None:
            channel.advance(target)
            if not alone:
                channel.lock.notify_all()
            return
        left = None if end_ns is None else end_ns - monotonic_ns()
        waits = [w for w in (left, patience) if w is not None and w > 0]
        channel.lock.wait(min(waits) / 1e9 if waits else None)

    def _missing(self) -> int | None:
        """The time to wait for threads that are elsewhere, ns; None: there are none."""
        if len(self._seen) == len(self._waiters):
            return None
        latest = 0
        for thread in [t for t in self._seen if t not in self._waiters]:
            if thread.is_alive():
                latest = max(latest, self._seen[thread])
            else:
                del self._seen[thread]
        if latest and self._strict:
            return PATIENCE_NS  # until then, whoever has ended is noticed
        return latest + PATIENCE_NS - monotonic_ns() if latest else None


def _move_alone(channel: Paced, ready: Callable[[], bool], until_ps: int | None) -> bool:
    """Advance for the only thread until it is `ready`, or to its end; False if neither comes."""
    while True:
        target = earlier(channel.next_ps(), until_ps)
        if target is None:
            return False
        channel.advance(target)
        if target == until_ps or ready():
            return True


def earlier(one_ps: int | None, other_ps: int | None) -> int | None:
    """The earlier of two times, ps; None: never."""
    if one_ps is None or (other_ps is not None and other_ps < one_ps):
        return other_ps
    return one_ps


def _reached(channel: Paced, moment_ps: int | None) -> bool:
    return moment_ps is not None and channel.now_ps >= moment_ps


def _passed(moment_ns: int | None) -> bool:
    return moment_ns is not None and monotonic_ns() >= moment_ns
