"""Disturbances of a simulated wire that outlast a change of its nodes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import final

from cosim.base.copies import replace
from cosim.bus.frames import BusFrame
from cosim.bus.settings import Disturbance, ErrorRate, Interruption, ScriptedError


@dataclass(frozen=True, slots=True)
class _Given:
    """A disturbance, when it was given, and how many attempts of its frame were before."""

    disturbance: Disturbance
    at_ps: int
    attempts: int


@final
class Disturbances:
    """Disturbances of a wire; a bus that is made later gets those that are left."""

    def __init__(self) -> None:
        self._given: list[_Given] = []
        self._attempts: Counter[tuple[int, bool]] = Counter()

    def add(self, disturbance: Disturbance, now_ps: int) -> None:
        """Add one; its attempts and its times (ps) count from now."""
        before = 0
        if isinstance(disturbance, ScriptedError):
            before = self._attempts[disturbance.identifier, disturbance.extended]
        self._given.append(_Given(disturbance, now_ps, before))

    def attempted(self, frame: BusFrame) -> None:
        """Count an attempt to send a frame, if that is of interest yet."""
        if self._given:
            self._attempts[frame.identifier, frame.format.extended] += 1

    def left(self, now_ps: int) -> list[Disturbance]:
        """Disturbances still to come, for a bus whose time 0 is `now_ps` (ps)."""
        found: list[Disturbance] = []
        for given in self._given:
            change = given.disturbance
            if isinstance(change, ErrorRate):
                found.append(change)
            elif isinstance(change, Interruption):
                shift = given.at_ps - now_ps
                if change.end_ps + shift > 0:
                    start = max(0, change.start_ps + shift)
                    found.append(replace(change, start_ps=start, end_ps=change.end_ps + shift))
            else:
                passed = self._attempts[change.identifier, change.extended] - given.attempts
                if change.attempt == 0:
                    found.append(change)
                elif change.attempt > passed:
                    found.append(replace(change, attempt=change.attempt - passed))
        return found
