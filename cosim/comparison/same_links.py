"""Check that all controllers run over the same links, by the recorded tables.

A table has one integer for each read of the receiver: the sample that it holds. It depends on the
seed and the channel's name, not on the sent values, but also on the sampling period. A controller
that sends more often than another one uses other tables, which this module detects.

The run folder of a case is deleted once it is measured. A table stays in the folder of the
comparison, under a name that follows from its contents: runs with the same table share a file.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from math import nan
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from cosim.base.errors import RunError
from cosim.comparison.documents import Case
from cosim.links.semantics import Grid
from cosim.links.storage import read_facts, table_groups, write_groups
from cosim.record.folder import reason

Key = tuple[str, int, str]  # link law, seed, channel
#: The folder of tables in that of a comparison that is not complete.
KEPT = "tables"


@dataclass(frozen=True, slots=True)
class RecordedTable:
    """The table that links of one channel and grid recorded, in the file `path`.

    `facts` of it; `rows`: the number of looks; `digest`: SHA-256 of the rows; `mean_age`: of what
    the receiver had, s, over its looks from the first sample on, NaN if there are none; `varies`:
    True if the age differs between two looks after the first arrival, by a sample or more.
    """

    channel: str
    facts: Mapping[str, Any]
    rows: int
    digest: str
    mean_age: float
    varies: bool
    path: Path

    @property
    def grid(self) -> Grid:
        """The times at which samples were sent and looked at."""
        return _grid(self.facts)

    def agrees(self, other: RecordedTable) -> bool:
        """True if both are of one channel, and hold the same as far as both go."""
        if (self.channel, self.grid) != (other.channel, other.grid):
            return False
        if self.rows == other.rows:
            return self.digest == other.digest
        return self.first_difference(other) is None

    def first_difference(self, other: RecordedTable) -> int | None:
        """The first look at which the two hold something else; None: as far as both go, none."""
        first = 0
        for mine, others in zip(table_groups(self.path), table_groups(other.path), strict=False):
            n = min(len(mine), len(others))
            wrong = np.flatnonzero(mine[:n] != others[:n])
            if wrong.size:
                return first + int(wrong[0])
            first += n
        return None


def keep(path: Path, folder: Path) -> RecordedTable:
    """The stored table of a link, with a file of its own in a folder.

    Raises ScenarioError if it cannot be read, RunError if there is no space for it.
    """
    facts, _ = read_facts(path)
    grid = _grid(facts)
    rows, received, total, digest = 0, 0, 0, sha256()
    least, greatest = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    for group in table_groups(path):
        digest.update(group.astype("<i4").tobytes())
        looks = np.arange(rows, rows + group.size, dtype=np.int64)
        age = grid.n_r * looks - grid.n_s * group.astype(np.int64)
        received, total = received + int((group >= 0).sum()), total + int(age[group >= 0].sum())
        after = age[group > 0]
        least, greatest = (int(after.min(initial=least)), int(after.max(initial=greatest)))
        rows += group.size
    name = sha256(f"{json.dumps(facts, sort_keys=True)} {digest.hexdigest()}".encode())
    kept = folder / f"{name.hexdigest()[:32]}.parquet"
    if not kept.exists():
        _copy(path, facts, kept)
    return RecordedTable(
        channel=str(facts["name"]),
        facts=facts,
        rows=rows,
        digest=digest.hexdigest(),
        mean_age=total / received * grid.h if received else nan,
        varies=greatest - least >= max(grid.n_s, grid.n_r),
        path=kept,
    )


def _copy(path: Path, facts: Mapping[str, Any], kept: Path) -> None:
    """Write a table, which other processes may be writing as well."""
    own = kept.with_name(f".{os.getpid()}-{kept.name}")
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_groups(own, facts, table_groups(path))
        own.replace(kept)
    except OSError as error:
        raise RunError(f"cannot write {kept}: {reason(error)}") from error


def _grid(facts: Mapping[str, Any]) -> Grid:
    sender, receiver = facts["sender_period"], facts["receiver_period"]
    return Grid(int(sender), int(receiver), float(facts["h"]))


@dataclass(slots=True)
class _Channel:
    """The longest table of a channel, from which case, and in how many runs it was recorded."""

    table: RecordedTable
    case: Case
    runs: int = 1


@dataclass(slots=True)
class Tables:
    """The tables of all runs, one kept of each (link law, seed, channel); `differences`: words.

    `files`: the owner of their files, which may delete them once nothing refers to it.
    """

    files: object = None
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
            if table.rows > known.table.rows:
                known.table, known.case = table, case

    @property
    def same(self) -> bool:
        """True if every run of a link law and seed recorded the same rows, channel by channel."""
        return not self.differences

    def ages(self, link: str) -> list[tuple[str, float]]:
        """Per channel of a link law, the mean age of what was held, s; of the first seed."""
        keys = [key for key in self.channels if key[0] == link]
        first = min((seed for _, seed, _ in keys), default=0)
        return [(key[2], self.channels[key].table.mean_age)
                for key in sorted(keys) if key[1] == first]  # fmt: skip

    def varies(self, link: str) -> bool:
        """True if the delay of a link law was not constant once samples had arrived."""
        tables = [c.table for key, c in self.channels.items() if key[0] == link]
        return any(table.varies for table in tables)

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
        ages = ", ".join(f"{name} {age:.3f} s" for name, age in self.ages(link))
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
                 "rows": c.table.rows, "sha256": c.table.digest[:16]}
                for (link, seed, channel), c in sorted(self.channels.items())
            ],
        }  # fmt: skip

    def save(self, folder: Path) -> None:
        """Write every table as a file that a scenario can replay, ``LINK-seedN/CHANNEL``.

        Raises RunError.

        Characters of a channel that a file name cannot hold are percent-encoded.
        """
        for (link, seed, channel), known in sorted(self.channels.items()):
            path = folder / f"{link}-seed{seed}" / f"{quote(channel, safe=' ')}.parquet"
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(known.table.path, path)
            except OSError as error:
                raise RunError(f"cannot write {path}: {reason(error)}") from error


def _difference(known: _Channel, case: Case, table: RecordedTable) -> str:
    where = f"{case.link}, seed {case.seed}, {table.channel}"
    if known.table.grid != table.grid:
        return (
            f"{where}: {case.controller} sends every {float(table.grid.sending_period):g} s, "
            f"{known.case.controller} every {float(known.table.grid.sending_period):g} s"
        )
    row = known.table.first_difference(table)
    return f"{where}: {case.controller} and {known.case.controller} differ from look {row} on"


def _digest(tables: Sequence[RecordedTable]) -> str:
    """One number for several tables: of the digests of their rows."""
    return sha256(" ".join(table.digest for table in tables).encode()).hexdigest()[:16]
