"""Periodic messages in the time of a simulated channel, as the broadcast manager of SocketCAN."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, final

import can
from can.broadcastmanager import (
    LimitedDurationCyclicSendTaskABC,
    ModifiableCyclicTaskABC,
    RestartableCyclicTaskABC,
)

from bridge.simulated_can.channel import Channel
from bridge.simulated_can.options import ChannelOperationError


class Sender(Protocol):
    """The receiver of the messages."""

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message, waiting up to `timeout` s."""


@final
class PeriodicTask(
    LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC
):
    """Messages in turn, one every `period` seconds of the channel, for `duration` seconds.

    `end_time`: when it ends, as the time stamps of the channel (s); None: not before it is stopped.
    """

    def __init__(
        self,
        sender: Sender,
        channel: Channel,
        messages: can.Message | Sequence[can.Message],
        period: float,
        duration: float | None = None,
        modifier: Callable[[can.Message], None] | None = None,
    ) -> None:
        super().__init__(messages, period, duration)
        if self.period_ns <= 0:
            raise ValueError(f"found a period of {period} s, expected at least 1e-9 s")
        self.refused = 0
        """Messages that the transmit queue had no room for, or the bus cannot carry."""
        self._sender, self._channel, self._modifier = sender, channel, modifier
        self._run: _PeriodicRun | None = None

    @property
    def stopped(self) -> bool:
        """True if it sends nothing more, as python-can's own tasks have it."""
        return self._run is None

    def start(self) -> None:
        """Send the first message now; does nothing to a task that runs."""
        if self._run is None:
            self._run = _PeriodicRun(self)
            began = self._channel.stamp(self._channel.schedule(self._run))
            self.end_time = began + self.duration if self.duration else None

    def stop(self) -> None:
        """Send no more."""
        self._run = None

    def step(self, run: _PeriodicRun, due_ps: int) -> int | None:
        """Send the message that is due at `due_ps` (ps); returns when the next is."""
        if self._run is not run:
            return None
        if run.over(due_ps, self.duration):
            self._run = None
            return None
        message = self.messages[run.count % len(self.messages)]
        if self._modifier is not None:
            self._modifier(message)
        try:
            self._sender.send(message)
        except (ChannelOperationError, ValueError, TypeError):
            self.refused += 1
        run.count += 1
        return due_ps + self.period_ns * 1000


@final
class _PeriodicRun:
    """A task from one start to the next stop."""

    def __init__(self, task: PeriodicTask) -> None:
        self._task = task
        self._start_ps: int | None = None
        self.count = 0

    def over(self, due_ps: int, duration: float | None) -> bool:
        """True if the duration (s; None or 0: no end) has passed at `due_ps` (ps)."""
        if self._start_ps is None:
            self._start_ps = due_ps
        return bool(duration) and due_ps - self._start_ps >= round((duration or 0) * 1e12)

    def fire(self, due_ps: int) -> int | None:
        """Send the messages of the channel's schedule that are due."""
        return self._task.step(self, due_ps)
