"""The rows of links' tables and players' values for the next ticks, drawn for a stretch at a time.

A stretch is many calls of the engine long, since each drawing costs a little for every table. With
many links a thread draws the next stretch while the engine runs, which has no part in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from threading import Thread
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.engine.binding import Vector
from cosim.schedule.parts import RunningBus
from cosim.schedule.plan import Plan

#: Ticks for which tables are drawn at once: at least, at most; bytes of all tables together.
STRETCH, LONGEST, TOGETHER = 1024, 16_384, 1 << 25
#: Links from which on the next stretch is drawn in a thread, and the rows of this one are kept so.
MANY = 256
#: A tick after all others.
NEVER = 1 << 62
T = TypeVar("T")


class Aside(Generic[T]):
    """Work in a thread beside the engine's, one piece at a time."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._thread: Thread | None = None
        self._done: list[T | BaseException] = []

    def start(self, work: Callable[[], T]) -> None:
        """Begin with a piece; the one before must have been waited for."""

        def do() -> None:
            try:
                self._done.append(work())
            except BaseException as error:  # is raised where the result is asked for
                self._done.append(error)

        self._thread = Thread(target=do, name=self._name, daemon=True)
        self._thread.start()

    def result(self) -> T | None:
        """Wait; what came of it, None if nothing was begun. Raises what the work has raised."""
        self.wait()
        found = self._done.pop() if self._done else None
        if isinstance(found, BaseException):
            raise found
        return found

    def wait(self) -> None:
        """Wait until the piece is done."""
        if self._thread is not None:
            self._thread.join()
            self._thread = None


class LinkRows(Struct, frozen=True):
    """Rows of the tables of all links of a plan, in their order.

    `rows`: one link after the other; `counts` (links,): how many each has.
    """

    rows: NDArray[np.int32]
    counts: NDArray[np.int64]

    def parts(self) -> list[NDArray[np.int32]]:
        """The part of each link, (count,)."""
        ends = np.cumsum(self.counts).tolist()
        return [self.rows[end - n : end] for end, n in zip(ends, self.counts.tolist(), strict=True)]


class DrawnRows(Struct, frozen=True):
    """Rows of links from tick `start` up to `end`, and where C finds them, (links,); values of
    players.

    `filled`: those that the run fills in, by the number of the link.
    """

    start: int
    end: int
    links: LinkRows
    addresses: NDArray[np.int64]
    filled: Mapping[int, NDArray[np.int32]]
    values: tuple[Vector, ...]


class RowTables:
    """All tables and players of a plan, from their first rows on.

    `buses`: those that fill in tables while they run, by link: rows of such plans are made for one
    call of the engine. `longest`: ticks drawn at once, at most; 0: :data:`LONGEST`.
    """

    def __init__(self, plan: Plan, buses: Mapping[str, RunningBus], longest: int = 0) -> None:
        from cosim.links.drawing import TableDrawing  # of plans with links only
        from cosim.links.table import DrawnTable

        self._plan = plan
        self._filled = {i: buses[x.name] for i, x in enumerate(plan.links) if x.name in buses}
        drawn, self._streams = dict[int, DrawnTable](), {}
        for i, link in enumerate(plan.links):
            if i in self._filled:
                continue
            if isinstance(link.table, DrawnTable):
                drawn[i] = link.table
            else:
                self._streams[i] = link.table.stream()
        self._places = np.array(list(drawn), np.int64)
        self._drawing = TableDrawing(tuple(drawn.values()))
        self._played = [player.source.stream() for player in plan.players]
        periods = [plan.component(x.target.component).period for x in plan.links]
        self._periods = np.array(periods, np.int64)
        bytes_a_tick = float((4 / self._periods).sum())
        most = max(STRETCH, int(TOGETHER / max(1.0, bytes_a_tick)))
        self._stretch = min(longest or LONGEST, most)
        self._ahead: Aside[DrawnRows] = Aside("link tables")

    def draw(self, tick: int, ticks: int) -> DrawnRows:
        """The stretch that begins at `tick`, for `ticks` ticks at least if it is the first.

        Raises RunError.
        """
        found = self._ahead.result()
        if found is None:
            found = self._drawn(tick, ticks if self._plan.buses else self._length(tick, ticks))
        self._draw_ahead(found.end)
        return found

    def draw_again(self, start: int, end: int) -> Iterator[DrawnRows]:
        """The rows of an earlier run from tick 0 to `start`, in pieces, and the stretch that it
        drew from there to `end`.

        To be used up before the next :meth:`draw`, and before any other. Raises RunError.
        """
        for tick in range(0, start, self._stretch):
            yield self._drawn(tick, min(self._stretch, start - tick))
        yield self._drawn(start, end - start)
        self._draw_ahead(end)

    def _length(self, tick: int, ticks: int) -> int:
        return max(ticks, min(self._stretch, self._plan.ticks - tick))

    def _draw_ahead(self, tick: int) -> None:
        """Begin with the next stretch, if there is one."""
        if len(self._plan.links) < MANY or self._plan.buses or tick >= self._plan.ticks:
            return
        self._ahead.start(lambda: self._drawn(tick, self._length(tick, 1)))

    def _drawn(self, tick: int, ticks: int) -> DrawnRows:
        counts = _hits(self._periods, tick, ticks)
        firsts = np.cumsum(counts) - counts
        rows = np.empty(int(counts.sum()), np.int32)
        addresses = rows.ctypes.data + firsts * rows.itemsize
        self._drawing.fill(rows, firsts[self._places], counts[self._places])
        for i, stream in self._streams.items():
            rows[firsts[i] :][: counts[i]] = stream.rows(int(counts[i]))
        filled = {}
        for i, bus in self._filled.items():
            filled[i] = bus.rows(self._plan.links[i].name, int(counts[i]))
            addresses[i] = filled[i].ctypes.data
        values = []
        for player, played in zip(self._plan.players, self._played, strict=True):
            period = self._plan.component(player.target.component).period
            values.append(np.ascontiguousarray(played.rows(_hits(period, tick, ticks)), np.float64))
        return DrawnRows(
            tick, tick + ticks, LinkRows(rows, counts), addresses, filled, tuple(values)
        )

    def close(self) -> None:
        """Wait for what is being drawn."""
        self._ahead.wait()


def filled_rows(drawn: DrawnRows, counts: Sequence[int]) -> LinkRows:
    """The rows of all links; of those that the run fills in the first `counts` (links,)."""
    parts = drawn.links.parts()
    for i, rows in drawn.filled.items():
        parts[i] = rows[: counts[i]]
    return LinkRows(np.concatenate(parts), np.array([len(x) for x in parts]))


def _hits(period: Any, tick: int, ticks: int) -> Any:
    """The number of steps of components of a `period`, a number or (n,), in these ticks."""
    return -(-(tick + ticks) // period) - -(-tick // period)
