"""One simulated time for several channels."""

from __future__ import annotations

from typing import final

from bridge.simulated_can.pace import BusPace, ChannelLock, Paced, SimulatedPace


@final
class SharedTime:
    """The simulated time of several channels: all of them are always at the same time.

    It passes when every thread that uses one of the channels waits in one of them. It waits for a
    thread that does something else as long as that takes; so results do not depend on the speed
    of the threads. `pace`: another rule for when time passes.
    """

    def __init__(self, pace: BusPace | None = None) -> None:
        self.lock = ChannelLock()
        self.pace: BusPace = pace or SimulatedPace(strict=True)
        self._now = 0
        self._channels: list[Paced] = []

    @property
    def now_ps(self) -> int:
        """The time of all channels, ps."""
        return self._now

    def join(self, channel: Paced) -> None:
        """Bring a new channel to this time, which it shares from now on."""
        with self.lock:
            channel.advance(self._now)
            self._channels.append(channel)

    def next_ps(self) -> int | None:
        """The next time at which something may happen on a channel, ps; None: nothing will by
        itself.
        """
        found = (channel.next_ps() for channel in self._channels)
        return min((t for t in found if t is not None), default=None)

    def advance(self, until_ps: int) -> None:
        """Bring all channels to `until_ps` (ps). Needs the lock."""
        for channel in self._channels:
            channel.advance(until_ps)
        self._now = until_ps
