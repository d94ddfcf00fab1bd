"""Ages of what the receiver of a link held, from the link's stored table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.links.storage import load_table, read_facts, table_groups
from cosim.record.piecewise import PairwiseSum
from cosim.record.signals import Array


@dataclass(frozen=True, slots=True)
class LinkAges:
    """Ages `age` (n,), s, at the steps of a receiver, `period` s apart; NaN: it held nothing yet.

    `sent` (n,): the number of the sample held; -1: none.
    """

    age: Array
    period: float
    sent: NDArray[Any]

    def waited(self, first: int) -> Array:
        """The ages (n,), s; before the first sample came, the time that the link has existed.

        `first`: the number of the first step.
        """
        steps = np.arange(first, first + self.age.size)
        return np.where(np.isnan(self.age), steps * self.period, self.age)


def link_ages(path: Path) -> LinkAges:
    """The ages in a stored table of a link. Raises ScenarioError for another file."""
    facts, rows = load_table(path)
    return _ages(facts, rows, 0)


def _ages(facts: Mapping[str, Any], rows: NDArray[np.int32], first: int) -> LinkAges:
    """The ages in rows of a table; `first`: the number of the first of them."""
    sent = rows.astype(np.int64)
    period = facts["receiver_period"]
    ticks = np.arange(first, first + sent.size) * period - sent * facts["sender_period"]
    return LinkAges(np.where(sent >= 0, ticks * facts["h"], nan), period * facts["h"], sent)


def age_groups(path: Path) -> Iterator[LinkAges]:
    """:func:`link_ages` in pieces. Raises ScenarioError for another file."""
    facts, _ = read_facts(path)
    first = 0
    for rows in table_groups(path):
        yield _ages(facts, rows, first)
        first += rows.size


@dataclass(frozen=True, slots=True)
class AgeSummary:
    """Ages of what a link's receiver held, s: `values` (k,), ascending, and how often each was.

    `mean` of all; `delays`: the least and the greatest age of a sample when it was first held;
    `lost`: the share of samples that were never held; `steps` of the receiver, `period` s apart.
    """

    values: Array
    counts: NDArray[np.int64]
    mean: float
    delays: tuple[float, float]
    lost: float
    steps: int
    period: float

    def percentile(self, q: float) -> float:
        """The age, s, below which `q` % are; between two of them on a line, as NumPy has it."""
        ends = np.cumsum(self.counts)
        place = (int(ends[-1]) - 1) * (q / 100)
        low = int(place)
        part = place - low
        a, b = (float(self.values[np.searchsorted(ends, k, side="right")])
                for k in (low, min(low + 1, int(ends[-1]) - 1)))  # fmt: skip
        return a + (b - a) * part if part < 0.5 else b - (b - a) * (1 - part)


def summarize_ages(path: Path) -> AgeSummary | None:
    """The ages in a stored table of a link; None where no sample came.

    Memory grows with the number of different ages, and by a bit for each sample. Raises
    ScenarioError for another file.
    """
    found: dict[float, int] = {}
    used, newest, before, steps, period = np.zeros(0, np.uint8), -1, -1, 0, 0.0
    least, greatest = inf, -inf
    for group in age_groups(path):
        steps, period = steps + group.sent.size, group.period
        held = group.sent >= 0
        new = held & (np.diff(group.sent, prepend=before) != 0)
        before = int(group.sent[-1])
        for age, count in zip(*np.unique(group.age[held], return_counts=True), strict=True):
            found[float(age)] = found.get(float(age), 0) + int(count)
        fresh = group.sent[new]
        if fresh.size:
            least = min(least, float(group.age[new].min()))
            greatest = max(greatest, float(group.age[new].max()))
            newest = max(newest, int(fresh.max()))
            used = np.pad(used, (0, max(0, newest // 8 + 1 - used.size)))
            np.bitwise_or.at(used, fresh >> 3, (1 << (fresh & 7)).astype(np.uint8))
    if not found:
        return None
    total = PairwiseSum(sum(found.values()))
    for group in age_groups(path):
        total.add(group.age[group.sent >= 0])
    values = np.array(sorted(found))
    counts = np.array([found[x] for x in values.tolist()], np.int64)
    lost = 1.0 - int.from_bytes(used.tobytes(), "little").bit_count() / (newest + 1)
    mean = total.value / int(counts.sum())
    return AgeSummary(values, counts, mean, (least, greatest), lost, steps, period)
