"""Readings of two clocks, by a process that may be interrupted between them."""

from __future__ import annotations

import pytest

from cosim.base import clock


class Interrupted:
    """A monotonic clock and a date, `AHEAD` ns apart; some readings are followed by a pause."""

    AHEAD = 10**18

    def __init__(self, pauses: dict[int, int]) -> None:
        self.now, self.reads, self.pauses = 0, 0, pauses

    def monotonic(self) -> int:
        now = self.now
        self.now += 100 + self.pauses.get(self.reads, 0)
        self.reads += 1
        return now

    def date(self) -> int:
        return self.monotonic() + self.AHEAD


@pytest.mark.parametrize("paused", [(), (0,), (1,), (0, 4, 7, 9), (2, 3, 6, 10, 13)])
def test_an_interruption_between_two_clocks_does_not_move_the_date(
    monkeypatch: pytest.MonkeyPatch, paused: tuple[int, ...]
) -> None:
    clocks = Interrupted(dict.fromkeys(paused, 30_000_000))
    monkeypatch.setattr(clock, "monotonic_ns", clocks.monotonic)
    monkeypatch.setattr(clock, "realtime_ns", clocks.date)
    assert abs(clock.realtime_offset_ns() - clocks.AHEAD) < 1000
