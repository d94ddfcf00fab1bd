"""Judgements of strict drives on a run, from their logs.

The rules, from the first frame that enables a drive to the last that disables it:

1. a torque other than 0 goes only to a drive that is enabled. Excepted are frames that arrived
   before the drive had told that it is not enabled any more, and one more: that of the slot that
   had read its bus before. A drive that was never enabled has told so from the beginning.
2. no watchdog expires;
3. no gap between two frames that feed the watchdog is longer than half of it.

Times are the kernel's stamps of the frames, so a busy judge does not lengthen them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Event = Mapping[str, Any]


@dataclass(frozen=True)
class DriveLog:
    """The events of one drive; `end` is the last one."""

    name: str
    events: tuple[Event, ...]

    @property
    def end(self) -> Event:
        return self.events[-1]

    def of(self, event: str) -> list[Event]:
        """The events of a kind."""
        return [e for e in self.events if e["event"] == event]

    @property
    def states(self) -> list[str]:
        """The states it has come to, one after the other."""
        return [e["after"] for e in self.of("state")]

    def misdeeds(self) -> Iterator[str]:
        """The acts that the rules forbid and that were done to it."""
        end = self.end
        if end["off"]:
            seen = self.of("torque while off")[:3]
            yield f"{self.name}: {end['off']} torques while not enabled, first {seen}"
        if end["trips"]:
            said = [e["seconds"] for e in self.of("watchdog")]
            yield f"{self.name}: its watchdog of {end['watchdog']:g} s expired after {said} s"
        elif end["watchdog"] and end["gap"] > end["watchdog"] / 2:
            yield f"{self.name}: unfed for {end['gap']:g} s, its watchdog is {end['watchdog']:g} s"
        if end["enabled"] and not end["watchdog"]:
            yield f"{self.name}: enabled without a watchdog"

    def worked(self) -> Iterator[str]:
        """The parts that are missing of a run in which it was enabled, and moved."""
        if not self.end["enabled"]:
            yield f"{self.name}: never enabled: {self.states or self.end['state']}"
        elif not self.end["torques"]:
            yield f"{self.name}: no torque"


def read(paths: Iterable[Path]) -> list[DriveLog]:
    """The drives of these logs."""
    found: list[DriveLog] = []
    for path in paths:
        lines = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
        for number in sorted({line["drive"] for line in lines}):
            mine = tuple(line for line in lines if line["drive"] == number)
            found.append(DriveLog(f"{path.stem} {number}", mine))
    return found


def misdeeds(logs: Iterable[DriveLog]) -> list[str]:
    """All of them."""
    return [text for log in logs for text in log.misdeeds()]
