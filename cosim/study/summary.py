"""The table of a sweep: in lines for a terminal, and as files."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from math import isfinite, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.errors import RunError
from cosim.base.files import write_file
from cosim.record.signals import Array
from cosim.study.store import write_records
from cosim.study.table import Records, SweepTable, column, entries, grouped

TABLE, SUMMARY = "table.parquet", "summary.csv"
#: The axis that is averaged over in the summary: it is there to repeat a run.
REPEATS = "seed"
#: Runs up to which there is a summary in any case, and lines of it that are written at once.
MANY, AT_ONCE = 100_000, 4096


def lines(table: SweepTable) -> list[str]:
    """The result: how many are stable, why others stopped, the range of measures."""
    records = table.records
    if not records:
        return ["no run yet"]
    stable = int(column(records, "stable").sum())
    failed = [i for i, reason in enumerate(entries(records, "reason")) if reason]
    left = table.points - len(records)
    first = f"{len(records)} runs: {stable} stable, {len(records) - stable} not"
    first += f" ({len(failed)} of them did not reach their end)" if failed else ""
    first += f"; {left} not run yet" if left else ""
    return [first, *_reasons([records[i] for i in failed], table.axes), *_ranges(table)]


def refuse_lost_runs(table: SweepTable) -> None:
    """Raise RunError where runs have no result: they neither ended nor stopped at a time of theirs.

    A run that diverges or is ended by a model has a time at which it stopped, which is a result.
    """
    reasons, stopped = entries(table.records, "reason"), column(table.records, "stopped_at")
    lost = [reason for reason, at in zip(reasons, stopped, strict=True) if reason and np.isnan(at)]
    if lost:
        raise RunError(
            f"{len(lost)} of {len(table.records)} runs have no result, the first of them: "
            f"{lost[0]}; --retry repeats them"
        )


def _reasons(failed: Sequence[Mapping[str, Any]], axes: Sequence[str]) -> list[str]:
    """The most frequent reasons, without the numbers in them, and an example of each."""
    kinds = Counter(_kind(r["reason"]) for r in failed)
    found = []
    for kind, n in kinds.most_common(5):
        example = next(r for r in failed if _kind(r["reason"]) == kind)
        where = ", ".join(f"{axis} = {cell(example[axis])}" for axis in axes)
        found.append(f"  {n} x {example['reason']}" + (f" ({where})" if where else ""))
    rest = len(failed) - sum(n for _, n in kinds.most_common(5))
    return [*found, f"  {rest} x for other reasons"] if rest else found


def _kind(reason: str) -> str:
    """The general part of a reason, without numbers and times: ``master: not a finite number``."""
    return reason.split(" = ")[0].split(" at tick")[0]


def _ranges(table: SweepTable) -> list[str]:
    rows = [("measure", "least", "median", "largest", "unit")]
    for name, unit in table.units.items():
        x = column(table.records, name)
        x = np.sort(x[~np.isnan(x)])  # inf, "never", is the largest
        if "." not in name or name.endswith((".settle_s", ".rmse")):
            shown = (x[0], x[len(x) // 2], x[-1]) if len(x) else (nan, nan, nan)
            least, median, largest = map(_number, shown)
            rows.append((name, least, median, largest, unit))
    widths = [max(len(row[i]) for row in rows) for i in range(4)]
    return [
        "  ".join(
            (row[0].ljust(widths[0]), *(row[i].rjust(widths[i]) for i in (1, 2, 3)), row[4])
        ).rstrip()
        for row in rows
    ]


def as_data(table: SweepTable) -> dict[str, Any]:
    """The numbers of runs and of stable ones, and the range of each measure, as plain data."""
    found = {"points": table.points, "runs": len(table.records)}
    found["stable"] = int(column(table.records, "stable").sum())
    found["failed"] = sum(map(bool, entries(table.records, "reason")))
    measures = {}
    for name, unit in table.units.items():
        x = column(table.records, name)
        x = np.sort(x[~np.isnan(x)])
        low, middle, high = (x[0], x[len(x) // 2], x[-1]) if len(x) else (nan, nan, nan)
        measures[name] = {
            "unit": unit, "least": float(low), "median": float(middle), "largest": float(high),
        }  # fmt: skip
    return {**found, "measures": measures}


def _number(value: float) -> str:
    return f"{value:.4g}" if isfinite(value) else "never" if value > 0 else "none"


def cell(value: object) -> str:
    """A value of an axis as it is printed."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


# ---- files --------------------------------------------------------------------------------------


def write(table: SweepTable, folder: Path) -> list[Path]:
    """Write ``table.parquet``, a row a run, and ``summary.csv``, a row for all of a point's seeds.

    Where a summary :func:`repeats_the_table`, there is none, and an older one goes. Each is
    replaced in one step. Raises RunError with the path.
    """
    if table.records:
        assert isinstance(table.records, Records)
        write_records(folder / TABLE, table.records.without("wall"), table.units)
    if repeats_the_table(table):
        (folder / SUMMARY).unlink(missing_ok=True)
        return [folder / TABLE]
    write_file(folder / SUMMARY, _csv(table))
    return [folder / TABLE, folder / SUMMARY]


def repeats_the_table(table: SweepTable) -> bool:
    """True if a summary would be long and say nothing new: many points, each with one run."""
    return len(table.records) > MANY and REPEATS not in table.axes


def _csv(table: SweepTable) -> Iterator[bytes]:
    """The lines of the summary, some thousand points at a time."""
    axes = [axis for axis in table.axes if axis != REPEATS]
    head = [f"{name}{what}" for name in table.units for what in ("", ".least", ".largest")]
    lines: list[Sequence[Any]] = [[*axes, "runs", "stable", "failed", *head]]
    keys = [entries(table.records, axis) for axis in axes]
    columns = [column(table.records, name) for name in table.units]
    stable = column(table.records, "stable")
    failed = np.array([bool(why) for why in entries(table.records, "reason")], dtype=bool)
    order, ends = grouped(table.records, axes)
    for start, end in pairwise([0, *ends.tolist()]):
        rows = order[start:end]
        numbers = [number for x in columns for number in _spread(x[rows])]
        key = [values[rows[0]] for values in keys]
        shares = [len(rows), float(stable[rows].mean()), int(failed[rows].sum())]
        lines.append([*key, *shares, *numbers])
        if len(lines) >= AT_ONCE:
            yield _text(lines)
            lines = []
    yield _text(lines)


def _text(lines: Sequence[Sequence[Any]]) -> bytes:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(lines)
    return out.getvalue().encode()


def _spread(x: Array) -> list[Any]:
    """Mean, least and greatest of the numbers among these (n,), or nothing of each."""
    if len(x) == 1:  # most of many
        return ["" if isnan(x[0]) else float(x[0])] * 3
    x = x[~np.isnan(x)]
    return [float(x.mean()), float(x.min()), float(x.max())] if len(x) else [""] * 3
