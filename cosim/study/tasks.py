"""Points in tasks: several runs in one call of a worker, which does some of them together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

from cosim.base.processes import Pool
from cosim.study.batch import PLACES
from cosim.study.design import Point
from cosim.study.run_point import StudyRow

#: How long a task should take, s: what is lost with a worker, and how often a row is seen.
SECONDS = 0.5
#: Runs in a task, at most.
MOST = 256
#: Tasks that are left for each worker, at least, so that all end at about the same time.
SHARES = 4


class Tasks(Iterator[Sequence[Point]]):
    """`count` points, some at a time. How many follows from the time that runs take; more than
    :data:`PLACES` are a multiple of it, because fewer runs together take as long.

    `alone`: one at a time. `left`: points that are in no task yet.
    """

    def __init__(self, points: Iterable[Point], count: int, *, alone: bool = False) -> None:
        self._points, self.left, self._alone = iter(points), count, alone
        self._pool: Pool | None = None
        self._wanted = PLACES

    def use(self, pool: Pool) -> None:
        """Tasks are for these workers."""
        self._pool = pool

    @property
    def slots(self) -> int:
        """The number of parallel calls."""
        return self._pool.slots if self._pool else 1

    def note(self, row: StudyRow) -> None:
        """Take the result of a run: which points come next does not depend on it."""

    def took(self, rows: Sequence[StudyRow]) -> None:
        """Take note of how long runs take."""
        mean = sum(row.wall for row in rows) / len(rows)
        self._wanted = min(MOST, int(SECONDS / mean)) if mean > 0 else MOST

    def __next__(self) -> Sequence[Point]:
        share = self.left // (SHARES * self.slots)
        size = (
            1
            if self._alone
            else max(1, min(max(self._wanted, self._pool.least if self._pool else 1), share))
        )
        size -= size % PLACES if size > PLACES else 0
        task = tuple(islice(self._points, size))
        if not task:
            raise StopIteration
        self.left -= len(task)
        return task
