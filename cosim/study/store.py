"""The folder of a sweep: every row that was ever measured, once, whatever ends the process.

A run that failed may be made again: its newest row counts, the old one stays where it is.

``journal.jsonl`` takes each row as it comes, in one write. When it is long, and at the end, its
rows become ``results/part-NNNNN.parquet`` by one rename, and it is emptied. A process may be
killed between any two of these: a torn last line is not a row, and rows that are in a part already
are dropped from the journal. (The system keeps what was written when a process is killed; not when
the power fails.)
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, final

import numpy as np

from cosim.base.copies import field_names
from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import write_file
from cosim.record.folder import reason
from cosim.study.design import Point
from cosim.study.run_point import StudyRow
from cosim.study.table import Records

JOURNAL, RESULTS, STATE = "journal.jsonl", "results", "sweep.json"
#: Rows of a part, and of the table that are written at once.
PART_ROWS, GROUP_ROWS = 1000, 1 << 18
#: Columns of each row, besides axes and measures.
_FIXED = ("run", "stable", "reason", "stopped_at", "wall", "settings")

Record = dict[str, Any]


@final
class ResultJournal:
    """Records in a file, a line of JSON each, which a process may be killed at any time to write.

    `rows`: the newest record of each run, by its key ``run``. Raises RunError with the path.
    """

    def __init__(self, path: Path, keep: Callable[[Record], bool] = lambda row: True) -> None:
        """Read what is there, and leave what `keep` says is to stay."""
        self.path = path
        self.rows = {run: row for run, row in read_journal(path).items() if keep(row)}
        lines = "".join(map(_line, self.rows.values()))
        write_file(path, lines.encode())
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND)

    def append(self, record: Record) -> None:
        """Store a record immediately."""
        try:
            _write(self._file, _line(record).encode())
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        self.rows.pop(record["run"], None)
        self.rows[record["run"]] = record

    def clear(self) -> None:
        """Forget all records. Raises OSError."""
        os.ftruncate(self._file, 0)
        self.rows = {}

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def read_journal(path: Path) -> dict[str, Record]:
    """Records of a journal by their runs, as far as it is whole; of each run the newest."""
    found: dict[str, Record] = {}
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    for line in lines:
        try:
            row = json.loads(line)
        except ValueError:
            break
        found[row["run"]] = row
    return found


def _line(record: Record) -> str:
    return json.dumps(record, ensure_ascii=False) + "\n"


@final
class Store:
    """Rows in a folder, for one process at a time; a context manager.

    `done`: names of the finished runs; `failed`: those of them whose newest row has a reason.
    `units`: of the measures, for the metadata of the parts.
    """

    def __init__(self, folder: Path, units: Mapping[str, str]) -> None:
        self.folder, self._units = folder, units
        try:
            (folder / RESULTS).mkdir(parents=True, exist_ok=True)
            ends = {run: end for part in parts(folder) for run, end in ends_of(part)}
            self._journal = ResultJournal(
                folder / JOURNAL, lambda row: ends.get(row["run"]) != _end(row)
            )
        except OSError as error:
            raise RunError(f"cannot use {folder}: {reason(error)}") from error
        ends |= {run: _end(row) for run, row in self._journal.rows.items()}
        self.done = set(ends)
        self.failed = {run for run, (why, _) in ends.items() if why}

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.flush()
        finally:
            self._journal.close()

    def append(self, row: StudyRow) -> None:
        """Store a row immediately. Raises RunError with the path."""
        self._journal.append({name: getattr(row, name) for name in field_names(row)})
        self.done.add(row.run)
        (self.failed.add if row.reason else self.failed.discard)(row.run)
        if len(self._journal.rows) >= PART_ROWS:
            self.flush()

    def flush(self) -> None:
        """Make a part of what is in the journal. Raises RunError with the path."""
        rows = self._journal.rows.values()
        if not rows:
            return
        path = self.folder / RESULTS / part_name(next_part(self.folder))
        try:
            write_table(path, [_flat(row) for row in rows], self._units)
            self._journal.clear()
        except OSError as error:
            raise RunError(f"cannot write {path}: {reason(error)}") from error


def rows(folder: Path) -> dict[str, Record]:
    """The newest row of every run by its name, flat: axes, measures and the fixed columns."""
    found: dict[str, Record] = {}
    for part in parts(folder):
        for row in rows_of(part):
            found[row["run"]] = row
    return found


def rows_of(part: Path) -> list[Record]:
    """The rows of a file of results, flat. Raises ScenarioError."""
    found: list[Record] = _table(part).to_pylist()
    return found


def records(
    folder: Path, points: Iterable[Point], axes: Sequence[str], measures: Sequence[str]
) -> Records:
    """The newest rows of points, in their order, as far as they are there."""
    place, columns = _columns(folder, measures)
    order, cells = list[int](), dict[str, list[Any]]({axis: [] for axis in axes})
    for point in points:
        at = place.get(point.run)
        if at is not None:
            order.append(at)
            for axis in axes:
                cells[axis].append(point.cells[axis])
    rows = np.array(order, dtype=np.intp)
    found: dict[str, Any] = {}
    for name in (*_FIXED[:-1], *axes, *measures, _FIXED[-1]):
        if name in cells:
            found[name] = np.empty(len(rows), dtype=object)
            found[name][:] = cells[name]
        else:
            found[name] = columns.pop(name)[rows]
    missing = {name: np.isnan(found[name]) & found["reason"].astype(bool) for name in measures}
    return Records(found, missing)


def _columns(folder: Path, measures: Sequence[str]) -> tuple[dict[str, int], dict[str, Any]]:
    """(row of each run that counts; the columns of all parts, one after the other)."""
    place: dict[str, int] = {}
    names = [*_FIXED, *measures]
    found: dict[str, list[Any]] = {name: [] for name in names}
    n = 0
    for part in parts(folder):
        table = _table(part)
        for name in names:
            found[name].append(_as_array(table, name))
        place |= {run: n + i for i, run in enumerate(found["run"][-1])}
        n += len(table)
    return place, {name: np.concatenate([*some, _none(name)]) for name, some in found.items()}


def _as_array(table: Any, name: str) -> Any:
    if name in table.column_names:
        return table[name].to_numpy(zero_copy_only=False)
    return np.full(len(table), np.nan)


def _none(name: str) -> Any:
    """No row of a column."""
    kind = {"stable": bool, "run": object, "reason": object, "settings": object}
    return np.empty(0, dtype=kind.get(name, np.float64))


def part_name(number: int) -> str:
    """The name of the file of results with this number."""
    return f"part-{number:05d}.parquet"


def next_part(folder: Path) -> int:
    """The number of the next file of results."""
    return max((int(path.stem.partition("-")[2]) for path in parts(folder)), default=-1) + 1


def parts(folder: Path) -> list[Path]:
    """The Parquet files of the results, in the order in which they were written."""
    return sorted((folder / RESULTS).glob("part-*.parquet"))


def ends_of(part: Path) -> Iterator[tuple[str, tuple[str, float]]]:
    """Each run of a file of results, with the reason of its failure and its wall time, s."""
    for row in _table(part, ["run", "reason", "wall"]).to_pylist():
        yield row["run"], _end(row)


def _end(row: Record) -> tuple[str, float]:
    """The facts that distinguish two rows of one run: how and when it ended."""
    return row["reason"], row["wall"]


def _table(part: Path, names: list[str] | None = None) -> Any:
    import pyarrow.parquet as pq

    try:
        return pq.ParquetFile(part).read(columns=names)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"not a part of a sweep: {reason(error)}", str(part)) from error


def _flat(row: Record) -> Record:
    fixed = {name: row[name] for name in _FIXED if name != "settings"}
    return {**fixed, **row["cells"], **row["measures"], "settings": json.dumps(row["settings"])}


def write_records(path: Path, records: Records, units: Mapping[str, str]) -> None:
    """Write the table of a sweep as :func:`write_table` does."""
    columns: dict[str, tuple[str, Any]] = {}
    for name, values in records.columns.items():
        mask = records.missing.get(name)
        if values.dtype == object:
            columns[name] = _typed(values.tolist())
        else:
            kind = "bool_" if values.dtype == bool else "float64"
            columns[name] = kind, values if mask is None else np.ma.masked_array(values, mask)
    _write_columns(path, columns, units)


def write_table(path: Path, rows: Sequence[Record], units: Mapping[str, str]) -> None:
    """Write flat rows as Parquet, replaced in one step; columns that a row lacks are null.

    A column is Boolean, float64 or text, by what is in it (numbers among texts become text).
    """
    names = list(dict.fromkeys(name for row in rows for name in row))
    names = [*(n for n in names if n != "settings"), "settings"]
    columns = {name: _typed([row.get(name) for row in rows]) for name in names}
    _write_columns(path, columns, units)


def _write_columns(
    path: Path, columns: Mapping[str, tuple[str, Any]], units: Mapping[str, str]
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = []
    for name, (kind, _) in columns.items():
        unit = {"stopped_at": "s", "wall": "s"}.get(name) or units.get(name)
        metadata = {"unit": unit} if unit else None
        fields.append(pa.field(name, getattr(pa, kind)(), metadata=metadata))
    schema, n = pa.schema(fields), max((len(x) for _, x in columns.values()), default=0)
    scratch = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with pq.ParquetWriter(scratch, schema) as writer:
            for i in range(0, max(n, 1), GROUP_ROWS):
                some = [x[i : i + GROUP_ROWS] for _, x in columns.values()]
                arrays = [pa.array(x, f.type) for x, f in zip(some, fields, strict=True)]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
        os.replace(scratch, path)
    finally:
        scratch.unlink(missing_ok=True)


def _typed(values: Iterable[Any]) -> tuple[str, list[Any]]:
    values = list(values)
    kinds = {type(v) for v in values if v is not None}
    if kinds and kinds <= {bool}:
        return "bool_", values
    if kinds <= {int, float}:
        return "float64", [None if v is None else float(v) for v in values]
    return "string", [v if v is None or isinstance(v, str) else str(v) for v in values]


# ---- what the folder is about -------------------------------------------------------------------


def read_state(folder: Path) -> Record:
    """``sweep.json``; empty if there is none. Raises ScenarioError."""
    path = folder / STATE
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ScenarioError(f"cannot be read: {reason(error)}", str(path)) from error
    if not isinstance(state, dict):
        raise ScenarioError(f"found a {type(state).__name__}, expected an object", str(path))
    return state


def write_state(folder: Path, state: Mapping[str, Any]) -> None:
    """Write ``sweep.json``, replaced in one step."""
    text = json.dumps(state, indent=2, ensure_ascii=False)
    write_file(folder / STATE, f"{text}\n".encode())


def _write(file: int, data: bytes) -> None:
    while data:
        data = data[os.write(file, data) :]
