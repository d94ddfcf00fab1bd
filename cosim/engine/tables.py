"""The rows of links' tables and players' values for the next ticks, drawn for a stretch at a time.

A stretch is many calls of the engine long, since each drawing costs some 20 us a link. With many
links a thread draws the next stretch while the engine runs, which has no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from cosim.engine.binding import Vector
from cosim.schedule.parts import RunningBus
from cosim.schedule.plan import Plan

#: Ticks for which tables are drawn at once: at least, at most; bytes of all tables together.
STRETCH, LONGEST, TOGETHER = 1024, 16_384, 1 << 27
#: Links from which on the next stretch is drawn in a thread.
MANY = 256
#: A tick after all others.
NEVER = 1 << 62


@dataclass(frozen=True, slots=True)
class DrawnRows:
    """Rows of links and values of players, (hits,) each, in their order, up to tick `end`."""

    end: int
    rows: tuple[NDArray[np.int32], ...]
    values: tuple[Vector, ...]


class RowTables:
    """All tables and players of a plan, from their first rows on.

    `buses`: those that fill in tables while they run, by link: rows of such plans are made for one
    call of the engine. `longest`: ticks drawn at once, at most; 0: :data:`LONGEST`.
    """

    def __init__(self, plan: Plan, buses: Mapping[str, RunningBus], longest: int = 0) -> None:
        self._plan, self._buses = plan, buses
        self._streams = [link.table.stream() for link in plan.links]
        self._played = [player.source.stream() for player in plan.players]
        bytes_a_tick = sum(4 / x.table.grid.n_r for x in plan.links)
        most = max(STRETCH, int(TOGETHER / max(1.0, bytes_a_tick)))
        self._stretch = min(longest or LONGEST, most)
        self._thread: Thread | None = None
        self._ahead: list[DrawnRows | BaseException] = []

    def draw(self, tick: int, ticks: int) -> DrawnRows:
        """The stretch that begins at `tick`, for `ticks` ticks at least if it is the first.

        Raises RunError.
        """
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            found = self._ahead.pop()
            if isinstance(found, BaseException):
                raise found
        else:
            found = self._drawn(tick, ticks if self._plan.buses else self._length(tick, ticks))
        self._draw_ahead(found.end)
        return found

    def _length(self, tick: int, ticks: int) -> int:
        return max(ticks, min(self._stretch, self._plan.ticks - tick))

    def _draw_ahead(self, tick: int) -> None:
        """Begin with the next stretch, if there is one."""
        if len(self._streams) < MANY or self._plan.buses or tick >= self._plan.ticks:
            return

        def work() -> None:
            try:
                self._ahead.append(self._drawn(tick, self._length(tick, 1)))
            except BaseException as error:  # is raised where the rows are asked for
                self._ahead.append(error)

        self._thread = Thread(target=work, name="link tables", daemon=True)
        self._thread.start()

    def _drawn(self, tick: int, ticks: int) -> DrawnRows:
        hits = _hits(self._plan, tick, ticks)
        rows = []
        for link, stream in zip(self._plan.links, self._streams, strict=True):
            n = hits(link.target.component)
            bus = self._buses.get(link.name)
            found = bus.rows(link.name, n) if bus else stream.rows(n)
            rows.append(np.ascontiguousarray(found, dtype=np.int32))
        values = [
            np.ascontiguousarray(played.rows(hits(x.target.component)), dtype=np.float64)
            for x, played in zip(self._plan.players, self._played, strict=True)
        ]
        return DrawnRows(tick + ticks, tuple(rows), tuple(values))

    def close(self) -> None:
        """Wait for what is being drawn."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None


def _hits(plan: Plan, tick: int, ticks: int) -> Callable[[str], int]:
    """The number of steps of a component in these ticks, as a function of its name."""
    by_period: dict[int, int] = {}

    def hits(name: str) -> int:
        period = plan.component(name).period
        if period not in by_period:
            by_period[period] = -(-(tick + ticks) // period) - -(-tick // period)
        return by_period[period]

    return hits
