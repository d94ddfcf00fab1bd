"""Samples of recordings, collected by stream in bounded memory."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from bridge.ping.exchanges import NONE, Integers
from bridge.ping.listening import KEPT

#: Most samples of all streams that are kept: 80 MB.
CAPACITY = 2_000_000
#: Most streams.
STREAMS = 4096


class RecordedSample(NamedTuple):
    """A sample of `stream` that was recorded at `t_ns` (NONE: known to be lost).

    `sequence`: its number; `published_ns`, `stamp_ns`: times of its publishing and of its content;
    NONE: not said. `key`: equal for equal contents, 0: no content. Times in ns.
    """

    stream: str
    t_ns: int
    sequence: int = NONE
    published_ns: int = NONE
    stamp_ns: int = NONE
    key: int = 0


@dataclass(slots=True)
class ReadingNotes:
    """Samples that a reader left out: `counts` by reason; `lines`: sentences of other losses."""

    counts: Counter[str] = field(default_factory=Counter)
    lines: list[str] = field(default_factory=list)

    def said(self) -> list[str]:
        """All in sentences."""
        return [*self.lines, *(f"{n} {reason}" for reason, n in self.counts.items())]


@dataclass(frozen=True, slots=True, eq=False)
class StreamRows:
    """The samples of a stream in the order of the file, one entry (n,) each, ns, NONE: not said.

    `t`: recorded; `sequence`, `published`, `stamp`, `key`: as in :class:`RecordedSample`.
    """

    t: Integers
    sequence: Integers
    published: Integers
    stamp: Integers
    key: Integers

    def where(self, rows: NDArray[Any]) -> StreamRows:
        """The samples that `rows` (a mask or an index) selects."""
        return StreamRows(
            self.t[rows], self.sequence[rows], self.published[rows], self.stamp[rows],
            self.key[rows],
        )  # fmt: skip

    def heard(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """The last recorded samples as :class:`bridge.ping.listening.StreamSample`, (m, 5), ns.

        Numbers that are all the same, and times of publishing that are those of recording, are
        what a recorder writes that does not know them: NONE.
        """
        rows = self.where(np.flatnonzero(self.t != NONE)[-KEPT:])
        numbers, published = rows.sequence, rows.published
        if rows.t.size and np.all(numbers == numbers[0]):
            numbers = np.full(rows.t.size, NONE)
        if np.all(published == rows.t):
            published = np.full(rows.t.size, NONE)
        return np.stack([rows.t, rows.t, numbers, published, rows.stamp], axis=1)


@final
class CollectedStreams:
    """Streams of one recording by name, with at most :data:`CAPACITY` samples.

    `full`: reading ended there, although the file has more. `found`: samples of each stream, also
    of those that are not wanted.
    """

    def __init__(self, samples: Iterable[RecordedSample], wanted: Iterable[str] = ()) -> None:
        """Read `samples`; keep those of the streams in `wanted`, or of all."""
        chosen, kept = set(wanted), 0
        self._parts: dict[str, array[int]] = {}
        self.found: Counter[str] = Counter()
        self.full = False
        for sample in samples:
            name = sample.stream
            self.found[name] += 1
            if chosen and name not in chosen:
                continue
            if kept == CAPACITY or len(self._parts) > STREAMS:
                self.full = True
                break
            part = self._parts.get(name)
            if part is None:
                part = self._parts[name] = array("q")
            part.extend(sample[1:])
            kept += 1

    @property
    def names(self) -> list[str]:
        """The streams that were kept, in the order of their first samples."""
        return list(self._parts)

    def rows(self, name: str) -> StreamRows:
        """The samples of a stream."""
        whole = np.frombuffer(self._parts[name], dtype=np.int64).reshape(-1, 5)
        return StreamRows(*(whole[:, k] for k in range(5)))
