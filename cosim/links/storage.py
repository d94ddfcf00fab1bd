"""Tables as Parquet files: one column `sent` (int32), everything else in the schema metadata.

The same rows and facts give the same bytes, however the rows were handed over. A stored table
replays: it answers like one that is drawn, without law or semantics. While a table is written it is
``NAME.rows``: a line of JSON with the facts, then the rows (int32, little-endian). Such a file of a
process that was killed is read like a finished one. Tables of many links are in one file
(:mod:`cosim.record.link_tables`), and their paths are in it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.base.convert import Struct
from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import Closing
from cosim.links.laws import IntArray
from cosim.links.semantics import Grid
from cosim.links.table import TableStream, check_indices
from cosim.record.folder import ROWS, TABLE_ROWS, TABLES, link_files, read_metadata, reason
from cosim.record.groups import arrow, numpy
from cosim.record.link_tables import complete, is_together, table_facts, table_rows

COLUMN = "sent"
FACTS = b"cosim.link"
GROUP = 1 << 18  # rows of a row group


def load_table(path: str | Path) -> tuple[dict[str, Any], NDArray[np.int32]]:
    """The facts and all rows (n,) of a stored table. Raises ScenarioError naming the file."""
    path = Path(path)
    facts, _ = read_facts(path)
    groups = list(table_groups(path))
    return facts, np.concatenate(groups) if groups else np.empty(0, np.int32)


class StoredTable(Struct, frozen=True):
    """A table in a file, to be replayed: law and semantics are what they were. See `open_table`.

    Its facts are those of its rows: `history` and `minimum_delay_ticks` were counted in them.
    """

    path: Path
    name: str
    grid: Grid
    length: int
    history: int
    minimum_delay_ticks: int

    def check(self, length: int) -> None:
        """Refuse a run that is longer than the file. Raises ScenarioError."""
        if length > self.length:
            raise ScenarioError(
                f"{self.length} rows, the run needs {length}; expected a shorter run",
                str(self.path),
            )

    def stream(self, length: int | None = None) -> TableStream:
        """The rows, read one row group at a time."""
        if length is not None:
            self.check(length)
        return TableStream(_StoredRows(self.path), self.length)

    def facts(self) -> dict[str, Any]:
        """The facts in the file, for its replay."""
        facts, _ = read_facts(self.path)
        return {**facts, "name": self.name, "replay": self.path.name}


def open_table(path: Path, *, name: str, grid: Grid) -> StoredTable:
    """A stored table for a link between these periods; every row is checked.

    Raises ScenarioError if the file is not a table, belongs to other periods, or contains a sample
    before it was sent; the message names the file and the row.
    """
    facts, length = read_facts(path)
    found = tuple(facts.get(key) for key in ("sender_period", "receiver_period", "h"))
    if found[:2] != (grid.n_s, grid.n_r) or not _same(found[2], grid.h):
        raise ScenarioError(
            f"stored for periods of {found[0]} and {found[1]} ticks of {found[2]} s; expected"
            f" {grid.n_s} and {grid.n_r} ticks of {grid.h:g} s",
            str(path),
        )
    check_indices(grid, length)
    least, greatest, row, before = None, 0, 0, -1
    for sent in table_groups(path):
        ages, fresh = _ages(sent, before, row, grid, path)
        if ages.size:
            smallest = int(ages.min())
            least = smallest if least is None else min(least, smallest)
        greatest = max(greatest, int(fresh.max(initial=0)))
        row, before = row + sent.size, int(sent[-1])
    minimum = grid.up(1) if least is None else least
    return StoredTable(path, name, grid, length, greatest // grid.n_s + 1, minimum)


def _ages(
    sent: NDArray[np.int32], before: int, row: int, grid: Grid, path: Path
) -> tuple[IntArray, IntArray]:
    """Ages (ticks) of what is held, and of those rows that differ from the row before."""
    tick = grid.n_r * np.arange(row, row + sent.size, dtype=np.int64)
    age = tick - grid.n_s * sent.astype(np.int64)
    wrong = (age < 0) | (sent < -1)
    if wrong.any():
        first = int(np.argmax(wrong))
        raise ScenarioError(
            f"holds sample {sent[first]}, but {grid.sent(row + first + 1)} samples are sent by"
            " then",
            f"{path}: row {row + first}",
        )
    held = sent >= 0
    new = held & (sent != np.concatenate(([before], sent[:-1])))
    return age[held], age[new]


class _StoredRows:
    def __init__(self, path: Path) -> None:
        self._groups = table_groups(path)
        self._rest = np.empty(0, np.int32)

    def take(self, n: int) -> NDArray[np.int32]:
        parts = []
        while n:
            if not self._rest.size:
                self._rest = next(self._groups)
            parts.append(self._rest[:n])
            self._rest = self._rest[parts[-1].size :]
            n -= parts[-1].size
        return np.concatenate([np.empty(0, np.int32), *parts])


def table_groups(path: Path) -> Iterator[NDArray[np.int32]]:
    """The rows, one group (k,) after the other; empty groups are left out.

    Raises ScenarioError, naming the file, if a group cannot be read.
    """
    if path.suffix == ROWS:
        yield from _rows_of_unfinished(path)
        return
    if is_together(path):
        rows = table_rows(path)
        yield from (rows[first : first + GROUP] for first in range(0, len(rows), GROUP))
        return
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        for group in range(file.num_row_groups):
            try:
                rows = numpy(file.read_row_group(group, columns=[COLUMN]).column(0), np.int32)
            except (OSError, ValueError) as error:  # pyarrow's errors derive from these
                text = f"row group {group} cannot be read: {error}"
                raise ScenarioError(text, str(path)) from None
            if rows.size:
                yield rows


def _rows_of_unfinished(path: Path) -> Iterator[NDArray[np.int32]]:
    """The rows of a file of rows; the last one may be cut."""
    with path.open("rb") as file:
        file.readline()
        while data := file.read(4 * GROUP):
            if rows := len(data) // 4:
                yield np.frombuffer(data, "<i4", rows).astype(np.int32, copy=False)


def read_facts(path: Path) -> tuple[dict[str, Any], int]:
    """Facts and number of rows. Raises ScenarioError if this is not a link table."""
    schema: str | bytes
    if is_together(path):
        schema, length = table_facts(path)
    elif not path.is_file():
        raise ScenarioError("no such file; expected a stored link table", str(path))
    else:
        schema, length = _row_file_facts(path) if path.suffix == ROWS else _parquet_facts(path)
    try:
        facts = json.loads(schema)
    except ValueError as error:  # also UnicodeDecodeError
        raise ScenarioError(f"its metadata is not readable JSON: {error}", str(path)) from None
    if not isinstance(facts, dict):
        raise ScenarioError(f"its metadata is {facts!r}; expected a JSON object", str(path))
    return facts, length


def _row_file_facts(path: Path) -> tuple[bytes, int]:
    """The text of the facts, and the number of rows."""
    with path.open("rb") as file:
        text = file.readline()
        return text, (path.stat().st_size - len(text)) // 4


def _parquet_facts(path: Path) -> tuple[bytes, int]:
    """The text of the facts, and the number of rows. Raises ScenarioError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            schema, length = file.schema_arrow, file.metadata.num_rows
    except (pa.ArrowException, OSError) as error:
        raise ScenarioError(f"not a Parquet file ({error})", str(path)) from None
    index = schema.get_field_index(COLUMN)
    if index < 0 or schema.field(index).type != pa.int32() or FACTS not in (schema.metadata or {}):
        raise ScenarioError(
            f"columns {', '.join(schema.names) or 'none'}; expected a link table: an int32 column"
            f" {COLUMN!r} and the metadata {FACTS.decode()!r}",
            str(path),
        )
    return schema.metadata[FACTS], int(length)


def _same(found: object, h: float) -> bool:
    return isinstance(found, int | float) and abs(found - h) <= 1e-12 * h


class TableWriter(Closing):
    """Writes rows immediately at each call; a context manager. Memory: one row group.

    `facts`: the result of :meth:`TableSpec.facts`, or at least `name`, `sender_period`,
    `receiver_period` (ticks) and `h` (s), which a replay requires. Raises RunError with the path if
    the file cannot be written.
    """

    def __init__(self, path: Path, facts: Mapping[str, Any]) -> None:
        self._path, self._rows = path, path.with_suffix(ROWS)
        text = json.dumps(facts, sort_keys=True, allow_nan=False)
        with _write_errors(self._rows):
            self._file = _new_file(self._rows, f"{text}\n".encode())

    def write(self, rows: ArrayLike) -> None:
        """Append rows, (n,) integers."""
        with _write_errors(self._rows):
            _write_all(self._file, np.asarray(rows, dtype="<i4").tobytes())

    def close(self) -> None:
        """Make the Parquet file, and delete the one it was made from."""
        with _write_errors(self._path):
            self._file.close()
            convert(self._rows, self._path)
            self._rows.unlink()


def _new_file(path: Path, first: bytes) -> FileIO:
    """A new file that begins with `first`: it does not exist without it. Raises OSError."""
    part = path.with_name(f"{path.name}.part")
    file = FileIO(part, "wb")
    try:
        _write_all(file, first)
        part.replace(path)
    except BaseException:
        file.close()
        part.unlink(missing_ok=True)
        raise
    return file


def _write_all(file: FileIO, data: bytes) -> None:
    """Write all of it: the system may take less at a time."""
    left = memoryview(data)
    while left:
        left = left[file.write(left) :]


def convert(rows: Path, path: Path) -> None:
    """Make the Parquet file of a file of rows. Raises OSError, ScenarioError."""
    facts, _ = read_facts(rows)
    write_groups(path, facts, table_groups(rows))


def write_groups(path: Path, facts: Mapping[str, Any], groups: Iterable[NDArray[np.int32]]) -> None:
    """Write the Parquet file of a table, one row group for each of `groups` (k,).

    The file appears once it is complete. Raises OSError.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    what = {"description": "index of the sent sample held at each look; -1: none yet"}
    field = pa.field(COLUMN, pa.int32(), nullable=False, metadata=what)
    text = json.dumps(facts, sort_keys=True, allow_nan=False)
    schema = pa.schema([field], metadata={FACTS: text.encode()})
    part = path.with_name(f"{path.name}.part")
    with (
        pa.OSFile(str(part), "wb") as sink,
        pq.ParquetWriter(
            sink,
            schema,
            compression="zstd",
            use_dictionary=False,
            column_encoding={COLUMN: "DELTA_BINARY_PACKED"},
        ) as writer,
    ):
        for group in groups:
            writer.write_batch(pa.record_batch([arrow(group)], schema=schema), GROUP)
    part.replace(path)


@contextmanager
def _write_errors(path: Path) -> Iterator[None]:
    """Turn system errors in the block into a RunError that names the file."""
    try:
        yield
    except OSError as error:
        raise RunError(f"cannot write {path}: {reason(error)}") from error


def recover_tables(folder: Path) -> None:
    """Make the tables of a run that was cut short into Parquet files. Raises CosimError."""
    if (folder / TABLE_ROWS).exists():
        with _write_errors(folder / TABLES):
            complete(folder, read_metadata(folder).get("links", {}))
    for rows in link_files(folder).values():
        if rows.suffix == ROWS:
            with _write_errors(rows):
                convert(rows, rows.with_suffix(".parquet"))
                rows.unlink()
