"""Statistics of the requests on a simulated bus: response times, losses and their causes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.bus.frames import BusEvent, BusFrame, DropCause, frame_of
from cosim.bus.timing import BusTiming


@dataclass(frozen=True, slots=True)
class BusHistory:
    """The history of a bus: `requests` (n,) rows of ``REQUEST``, `events` (m,) of ``EVENT``.

    `names`: of the nodes, by their number.
    """

    timing: BusTiming
    names: tuple[str, ...]
    requests: NDArray[np.void]
    events: NDArray[np.void]

    def sent(self) -> Iterator[tuple[int, BusFrame]]:
        """Each frame that was sent, with the time of the end of its last bit, ps."""
        for row in self.events[self.events["kind"] == BusEvent.SENT]:
            yield int(row["time"]), frame_of(self.requests[row["request"]]["frame"])


@dataclass(frozen=True, slots=True)
class IdentifierAccount:
    """An identifier's frames: how many were sent, and how long they took, ps.

    `times`, shape (sent,), sorted: from the request to the end of EOF. `worst_queueing`: from the
    request to the start of the attempt that succeeded. `errors`: attempts that failed. `lost`: how
    many requests were dropped, by cause. `waiting`: requests without an end so far.
    """

    identifier: int
    extended: bool
    times: NDArray[np.int64] = field(repr=False)
    worst_queueing: int
    errors: int
    lost: dict[DropCause, int]
    waiting: int

    @property
    def sent(self) -> int:
        """Number of frames sent."""
        return len(self.times)

    @property
    def mean(self) -> float:
        """Mean response time, ps; 0 if none was sent."""
        return float(self.times.mean()) if len(self.times) else 0.0

    @property
    def worst(self) -> int:
        """Worst response time, ps; 0 if none was sent."""
        return int(self.times[-1]) if len(self.times) else 0

    def quantile(self, share: float) -> int:
        """The response time (ps) that `share` (0 to 1) of the frames do not exceed.

        One of the times that occurred; 0 if none was sent.
        """
        if not len(self.times):
            return 0
        return int(self.times[max(0, int(np.ceil(share * len(self.times))) - 1)])

    def histogram(self, width_ps: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(counts (k,), edges (k + 1,) in ps): response times in classes of `width_ps`, from 0."""
        edges = np.arange(self.worst // width_ps + 2, dtype=np.int64) * width_ps
        return np.bincount(self.times // width_ps, minlength=len(edges) - 1), edges


class LostFrame(NamedTuple):
    """A request that was dropped: when (ps), which, at which node, and why.

    `blocked_by`: how long (ps) each node had the bus while the request, or the one that waited
    longest in the full queue, was waiting; the most first. -1: disturbances of the idle bus.
    """

    time_ps: int
    request: int
    node: int
    cause: DropCause
    blocked_by: dict[int, int]


def accounts(
    requests: NDArray[np.void], events: NDArray[np.void], first: int = 0
) -> list[IdentifierAccount]:
    """The account of each identifier, by identifier.

    `requests`: rows of ``REQUEST``, shape (n,), in the order in which they were made; `first`: the
    number of the first. `events`: all events since, shape (m,), with STARTED, SENT, ERROR and
    DROPPED recorded. Times in ps.
    """
    events = events[(events["request"] >= first) & (events["request"] < first + len(requests))]
    begun, ended = (np.full(len(requests), -1, np.int64) for _ in range(2))
    for kind, times in ((BusEvent.STARTED, begun), (BusEvent.SENT, ended)):
        rows = events[events["kind"] == kind]
        times[rows["request"] - first] = rows["time"]  # of several, the last
    failed = events[(events["kind"] == BusEvent.ERROR) & (events["role"] & 2 != 0)]
    errors = np.bincount(failed["request"] - first, minlength=len(requests))
    dropped = _dropped(events)
    extended = requests["frame"]["flags"] & 16 != 0
    key = requests["frame"]["id"].astype(np.int64) << 1 | extended
    found = []
    for value in np.unique(key).tolist():
        mine = key == value
        sent = mine & (ended >= 0)
        causes = dropped["code"][mine[dropped["request"] - first]]
        found.append(
            IdentifierAccount(
                identifier=value >> 1,
                extended=bool(value & 1),
                times=np.sort((ended - requests["at"])[sent]),
                worst_queueing=int((begun - requests["at"])[sent].max(initial=0)),
                errors=int(errors[mine].sum()),
                lost={c: int((causes == c).sum()) for c in DropCause if (causes == c).any()},
                waiting=int(mine.sum() - sent.sum()) - len(causes),
            )
        )
    return found


def losses(
    requests: NDArray[np.void],
    events: NDArray[np.void],
    busy: NDArray[np.void],
    first: int = 0,
) -> list[LostFrame]:
    """List every dropped request of (n,) `requests`, and the frames on the bus during its time.

    `requests`, `events`, `first`: as for :func:`accounts`; `busy`: rows of
    ``cosim.bus.transmissions.transmissions``. Frames that a receive FIFO dropped are not requests;
    count their DROPPED events with RECEIVE_OVERFLOW.
    """
    events = events[(events["request"] >= first) & (events["request"] < first + len(requests))]
    dropped = _dropped(events)
    over = np.full(len(requests), np.iinfo(np.int64).max)
    for rows in (events[events["kind"] == BusEvent.SENT], dropped):
        over[rows["request"] - first] = rows["time"]
    found = []
    for row in dropped:
        number, time, node = int(row["request"]) - first, int(row["time"]), int(row["node"])
        since = int(requests["at"][number])
        if row["code"] == DropCause.OVERFLOW:
            there = (requests["node"] == node) & (requests["at"] <= time) & (over >= time)
            since = int(requests["at"][there].min())
        cause = DropCause(int(row["code"]))
        found.append(LostFrame(time, number + first, node, cause, _taken(busy, since, time)))
    return found


def _dropped(events: NDArray[np.void]) -> NDArray[np.void]:
    lost = events["code"] != DropCause.RECEIVE_OVERFLOW
    rows: NDArray[np.void] = events[(events["kind"] == BusEvent.DROPPED) & lost]
    return rows


def _taken(busy: NDArray[np.void], start: int, end: int) -> dict[int, int]:
    """Time for which each node occupied the bus between two times, ps."""
    low = np.searchsorted(busy["end"], start, side="right")
    high = np.searchsorted(busy["start"], end, side="left")
    rows = busy[low:high]
    shares = np.minimum(rows["end"], end) - np.maximum(rows["start"], start)
    nodes, which = np.unique(rows["node"], return_inverse=True)
    sums = np.zeros(len(nodes), np.int64)
    np.add.at(sums, which, shares)
    order = np.argsort(-sums, kind="stable")
    return {int(nodes[i]): int(sums[i]) for i in order}


def waits(
    requests: NDArray[np.void], events: NDArray[np.void], first: int = 0
) -> list[tuple[int, int, int]]:
    """(node, start, end) of each request that waited, ps: until its last attempt or its drop.

    Arguments as for :func:`accounts`.
    """
    last: dict[int, int] = {}
    kinds = (events["kind"] == BusEvent.STARTED) | (events["kind"] == BusEvent.DROPPED)
    for row in events[kinds]:
        last[int(row["request"])] = int(row["time"])
    found = []
    for number, (node, at) in enumerate(requests[["node", "at"]].tolist(), first):
        if last.get(number, at) > at:
            found.append((node, at, last[number]))
    return found
