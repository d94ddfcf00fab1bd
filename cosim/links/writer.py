"""Writes the tables of links: rows as they come, and a Parquet file of them at the end."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cosim.base.closing import Closing
from cosim.base.errors import RunError
from cosim.links.storage import COLUMN, FACTS, GROUP, read_facts, table_groups
from cosim.record.arrow import arrow
from cosim.record.folder import ROWS, TABLE_ROWS, TABLES, link_files, read_metadata, reason
from cosim.record.link_tables import complete


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
