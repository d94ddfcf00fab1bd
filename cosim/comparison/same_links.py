"""Check that all controllers run over the same links, by the recorded tables.

A table has one integer for each read of the receiver: the sample that it holds. It depends on the
seed and the channel's name, not on the sent values, but also on the sampling period. A controller
that sends more often than another one uses other tables, which this module detects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from cosim.comparison.documents import Case
from cosim.comparison.measure import RecordedTable
from cosim.links.storage import TableWriter
from cosim.links.table import LinkStatistics, statistics

Key = tuple[str, int, str]  # link law, seed, channel


@dataclass(slots=True)
class _Channel:
    """The longest table of a channel, from which case, and in how many runs it was recorded."""

    table: RecordedTable
    case: Case
    runs: int = 1


@dataclass(slots=True)
class Tables:
    """The tables of all runs, one kept of each (link law, seed, channel); `differences`: words."""

    channels: dict[Key, _Channel] = field(default_factory=dict)
    differences: list[str] = field(default_factory=list)

    def add(self, case: Case, tables: Sequence[RecordedTable]) -> None:
        """Take the tables that a run recorded."""
        for table in tables:
            key = (case.link, case.seed, table.channel)
            known = self.channels.get(key)
            if known is None:
                self.channels[key] = _Channel(table, case)
                continue
            if not known.table.agrees(table):
                self.differences.append(_difference(known, case, table))
                continue
            known.runs += 1
            if len(table.rows) > len(known.table.rows):
                known.table, known.case = table, case

    @property
    def same(self) -> bool:
        """True if every run of a link law and seed recorded the same rows, channel by channel."""
        return not self.differences

    def ages(self, link: str) -> list[tuple[str, LinkStatistics]]:
        """Per channel of a link law, the ages of what was held; of the first seed."""
        keys = [key for key in self.channels if key[0] == link]
        first = min((seed for _, seed, _ in keys), default=0)
        found = []
        for key in sorted(keys):
            if key[1] == first:
                table = self.channels[key].table
                found.append((key[2], statistics(table.rows, table.grid)))
        return found

    def varies(self, link: str) -> bool:
        """True if the delay of a link law was not constant once samples had arrived."""
        tables = [c.table for key, c in self.channels.items() if key[0] == link]
        return any(_varies(table) for table in tables)

    def sentences(self, links: Sequence[str]) -> list[str]:
        """Sentences about the link tables: one line per link law, or the differences."""
        lines = [line for link in links for line in self._sentence(link)]
        if self.same:
            return lines
        shown = self.differences[:4]
        if len(self.differences) > len(shown):
            shown.append(f"and {len(self.differences) - len(shown)} more")
        return [*lines, "NOT the same tables for all controllers:", *(f"  {x}" for x in shown)]

    def _sentence(self, link: str) -> list[str]:
        channels = {key: c for key, c in self.channels.items() if key[0] == link}
        if not channels:
            return [f"{link}: nothing was recorded"]
        runs = sum(c.runs for c in channels.values())
        digest = _digest([c.table for _, c in sorted(channels.items())])
        seeds = sorted({seed for _, seed, _ in channels})
        ages = ", ".join(f"{name} {s.age_mean:.3f} s" for name, s in self.ages(link))
        text = f"{len(channels)} tables in {runs} uses" + (
            "" if self.same else ", where they agree"
        )
        over = f"seed {seeds[0]}" if len(seeds) == 1 else f"seeds {seeds[0]} to {seeds[-1]}"
        return [f"{link}: {text}, {over}, sha256 {digest}; mean age {ages}"]

    def facts(self) -> dict[str, Any]:
        """The same links as plain data for JSON."""
        return {
            "same": self.same,
            "differences": list(self.differences),
            "tables": [
                {"link": link, "seed": seed, "channel": channel, "runs": c.runs,
                 "rows": len(c.table.rows), "sha256": _digest([c.table])}
                for (link, seed, channel), c in sorted(self.channels.items())
            ],
        }  # fmt: skip

    def save(self, folder: Path) -> None:
        """Write every table as a file that a scenario can replay, ``LINK-seedN/CHANNEL``.

        Characters of a channel that a file name cannot hold are percent-encoded.
        """
        for (link, seed, channel), known in sorted(self.channels.items()):
            path = folder / f"{link}-seed{seed}" / f"{quote(channel, safe=' ')}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            with TableWriter(path, known.table.facts) as writer:
                writer.write(known.table.rows)


def _difference(known: _Channel, case: Case, table: RecordedTable) -> str:
    where = f"{case.link}, seed {case.seed}, {table.channel}"
    if known.table.grid != table.grid:
        return (
            f"{where}: {case.controller} sends every {float(table.grid.sending_period):g} s, "
            f"{known.case.controller} every {float(known.table.grid.sending_period):g} s"
        )
    n = min(len(table.rows), len(known.table.rows))
    row = int(np.argmax(table.rows[:n] != known.table.rows[:n]))
    return f"{where}: {case.controller} and {known.case.controller} differ from look {row} on"


def _varies(table: RecordedTable) -> bool:
    """True if the age differs between two looks after the first arrival, by a sample or more."""
    grid, look = table.grid, np.flatnonzero(table.rows > 0)
    age = grid.n_r * look - grid.n_s * table.rows[look].astype(np.int64)
    return bool(len(age)) and bool(np.ptp(age) >= max(grid.n_s, grid.n_r))


def _digest(tables: Sequence[RecordedTable]) -> str:
    total = sha256()
    for table in tables:
        total.update(np.ascontiguousarray(table.rows, dtype="<i4").tobytes())
    return total.hexdigest()[:16]
