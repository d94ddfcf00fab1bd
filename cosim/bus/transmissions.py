"""Transmissions on a simulated bus, from its events: times, frames and results of attempts."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from cosim.bus.described import bit_ps
from cosim.bus.frames import BusEvent, ErrorRole
from cosim.bus.timing import BusTiming

INTERMISSION = 3
#: A stretch of time in which the bus was busy. `start`, `end` (of the intermission) in ps; `node`:
#: the transmitter (-1: none, a disturbance of the idle bus); `request`: its number or -1;
#: `outcome`: :class:`Outcome`; `code`: of the first error (``ErrorCode``) or 0; `senders`: how many
#: nodes began to send; `errors`: how many ERROR events there were.
TRANSMISSION = np.dtype(
    [
        ("start", "<i8"),
        ("end", "<i8"),
        ("request", "<i8"),
        ("node", "<i4"),
        ("senders", "<i4"),
        ("errors", "<i4"),
        ("outcome", "u1"),
        ("code", "u1"),
        ("reserved", "<u2"),
    ]
)


class Outcome(IntEnum):
    """The result of an attempt to send; UNDER_WAY: it had not ended at the end of the events."""

    SENT = 0
    FAILED = 1
    UNDER_WAY = 2


def transmissions(events: NDArray[np.void], timing: BusTiming, until_ps: int) -> NDArray[np.void]:
    """Every stretch of busy time, in order; rows of :data:`TRANSMISSION`, shape (n,).

    `events`: all events of the bus up to `until_ps` (ps), rows of ``EVENT``, shape (m,), with
    STARTED, SENT, LOST, ERROR, OVERLOAD and FREE recorded. A busy stretch begins with a start of
    frame, or where a disturbance makes the idle bus dominant. It ends with the intermission; an
    error frame belongs to the attempt that failed. The eight bits for which an error-passive
    transmitter waits are idle.
    """
    kind, time = events["kind"], events["time"]
    bit = bit_ps(timing.bitrate)
    first = _firsts(events, bit)
    count = len(first)
    rows = np.zeros(count, TRANSMISSION)
    if not count:
        return rows
    place = np.cumsum(np.isin(np.arange(len(events)), first)) - 1
    rows["start"] = time[first]
    noise = kind[first] != BusEvent.STARTED
    rows["start"][noise] -= (np.maximum(events["bit"][first][noise], 5) + 1) * np.int64(bit)
    rows["errors"] = _count(place, kind == BusEvent.ERROR, count)
    rows["senders"] = _count(place, kind == BusEvent.STARTED, count)
    troubled = _count(place, (kind == BusEvent.ERROR) | (kind == BusEvent.OVERLOAD), count) > 0
    sent, when = _first_of(place, kind == BusEvent.SENT)
    free, freed = _last_of(place, kind == BusEvent.FREE)
    end = np.append(rows["start"][1:], until_ps)
    open_ = np.ones(count, bool)
    open_[:-1] = False
    end[sent] = np.where(troubled[sent], end[sent], time[when] + INTERMISSION * bit)
    end[free] = time[freed]
    open_[sent] &= troubled[sent]
    open_[free] = False
    rows["start"][1:][noise[1:]] = np.maximum(rows["start"][1:], end[:-1])[noise[1:]]
    rows["end"] = np.minimum(end, np.append(rows["start"][1:], max(until_ps, int(end[-1]))))
    rows["outcome"] = np.where(open_ & (rows["errors"] == 0), Outcome.UNDER_WAY, Outcome.FAILED)
    rows["outcome"][sent] = Outcome.SENT
    _owners(rows, events, place, sent, when)
    failing, at = _first_of(place, kind == BusEvent.ERROR)
    rows["code"][failing] = events["code"][at]
    return rows


def _firsts(events: NDArray[np.void], bit: int) -> NDArray[np.intp]:
    """The events with which a busy stretch begins, (n,) indices."""
    kind, time = events["kind"], events["time"]
    started = np.flatnonzero(kind == BusEvent.STARTED)
    gap = np.diff(time[started], prepend=-(10 * bit))
    begins = started[gap > bit]  # a node may join in the bit after a start of frame
    trouble = np.flatnonzero((kind == BusEvent.ERROR) | (kind == BusEvent.OVERLOAD))
    if not len(trouble):
        return begins
    free = np.flatnonzero(kind == BusEvent.FREE)
    sent = np.flatnonzero(kind == BusEvent.SENT)
    begun = _latest(begins, trouble)
    freed = _latest(free, trouble)
    done = _latest(sent, trouble)
    after = trouble[np.searchsorted(trouble, done, side="right")]  # the first behind that frame
    late = (done > begun) & (time[after] > time[done] + INTERMISSION * bit)
    alone = trouble[(freed > begun) | (begun < 0) | (late & (freed < done))]
    since = _latest(free, alone)
    alone = alone[np.diff(since, prepend=-2) != 0]  # one for each FREE
    return np.union1d(begins, alone)


def _latest(indices: NDArray[np.intp], at: NDArray[np.intp]) -> NDArray[np.intp]:
    """For each of `at` the last of `indices` before it, or -1."""
    return np.append(indices, -1)[np.searchsorted(indices, at) - 1]


def _count(place: NDArray[np.intp], which: NDArray[np.bool_], count: int) -> NDArray[np.intp]:
    found = place[which]
    return np.bincount(found[found >= 0], minlength=count)


def _first_of(
    place: NDArray[np.intp], which: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(transmissions that have such an event, index of their first one)."""
    indices = np.flatnonzero(which & (place >= 0))
    found, at = np.unique(place[indices], return_index=True)
    return found, indices[at]


def _last_of(
    place: NDArray[np.intp], which: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(transmissions that have such an event, index of their last one)."""
    indices = np.flatnonzero(which & (place >= 0))[::-1]
    found, at = np.unique(place[indices], return_index=True)
    return found, indices[at]


def _owners(
    rows: NDArray[np.void],
    events: NDArray[np.void],
    place: NDArray[np.intp],
    sent: NDArray[np.intp],
    when: NDArray[np.intp],
) -> None:
    """The sending node: the successful one, else one that started and did not lose arbitration."""
    rows["node"], rows["request"] = -1, -1
    key = place.astype(np.int64) << 16 | (events["node"].astype(np.int64) & 0xFFFF)
    lost = key[events["kind"] == BusEvent.LOST]
    begun = (events["kind"] == BusEvent.STARTED) & ~np.isin(key, lost)
    failed = (events["kind"] == BusEvent.ERROR) & (events["role"] & ErrorRole.SENDER != 0)
    for which in (failed, begun):
        own, at = _first_of(place, which)
        rows["node"][own], rows["request"][own] = events["node"][at], events["request"][at]
    rows["node"][sent], rows["request"][sent] = events["node"][when], events["request"][when]


def busy_share(
    rows: NDArray[np.void], start_ps: int, until_ps: int, window_ps: int
) -> NDArray[np.float64]:
    """The busy share of each window, 0 to 1, shape (k, 2): all, and failed attempts alone.

    Windows of `window_ps` (ps) follow one another from `start_ps`; the last ends at `until_ps` and
    may be shorter. `rows`: of :func:`transmissions`.
    """
    edges = np.append(np.arange(start_ps, until_ps, window_ps, dtype=np.int64), until_ps)
    parts = [
        np.diff(_busy_until(part, edges)) / np.diff(edges)
        for part in (rows, rows[rows["outcome"] == Outcome.FAILED])
    ]
    return np.stack(parts, axis=1)


def _busy_until(rows: NDArray[np.void], t: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time for which the bus was busy before each time, ps; busy intervals do not overlap."""
    if not len(rows):
        return np.zeros(len(t), np.int64)
    gone = np.append(0, np.cumsum(rows["end"] - rows["start"]))
    n = np.searchsorted(rows["start"], t, side="right")
    running = np.where(n > 0, np.minimum(t, rows["end"][n - 1]) - rows["start"][n - 1], 0)
    result: NDArray[np.int64] = np.where(n > 0, gone[n - 1] + np.maximum(running, 0), 0)
    return result
