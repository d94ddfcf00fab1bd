"""Writes the tables of links: rows as they come, and a Parquet file of them at the end."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cosim.base.errors import RunError
from cosim.links.storage import COLUMN, FACTS, GROUP, read_facts, table_groups
from cosim.links.table import TableSpec
from cosim.record.arrow import arrow
from cosim.record.folder import ROWS, link_files, reason


class TableWriter:
    """Writes rows as they come, each call at once; a context manager. Memory: one row group.

    `facts`: what :meth:`TableSpec.facts` says, or at least `name`, `sender_period`,
    `receiver_period` (ticks) and `h` (s), without which a table does not replay. Raises RunError
    with the path where the file cannot be written.
    """

    def __init__(self, path: Path, facts: Mapping[str, Any]) -> None:
        self._path, self._rows = path, path.with_suffix(ROWS)
        with _writing(self._rows):
            self._file = self._rows.open("wb", buffering=0)
            text = json.dumps(facts, sort_keys=True, allow_nan=False)
            self._file.write(text.encode() + b"\n")

    def write(self, rows: ArrayLike) -> None:
        """Append rows, (n,) integers."""
        left = memoryview(np.asarray(rows, dtype="<i4").tobytes())
        with _writing(self._rows):
            while left:
                left = left[self._file.write(left) :]

    def close(self) -> None:
        """Make the Parquet file, and delete the one it was made from."""
        with _writing(self._path):
            self._file.close()
            _convert(self._rows, self._path)
            self._rows.unlink()

    def __enter__(self) -> TableWriter:
        """The writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close; what was written up to an error is kept."""
        try:
            self.close()
        except RunError as failure:
            if error is None:
                raise
            error.add_note(str(failure))  # what stopped the run comes first


def _convert(rows: Path, path: Path) -> None:
    """The Parquet file of a file of rows."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    facts, _ = read_facts(rows)
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
        for group in table_groups(rows):
            writer.write_batch(pa.record_batch([arrow(group)], schema=schema), GROUP)
    part.replace(path)


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """What the system refuses in the block becomes a RunError that names the file."""
    try:
        yield
    except OSError as error:
        raise RunError(f"cannot write {path}: {reason(error)}") from error


def recover_tables(folder: Path) -> None:
    """Make the tables of a run that was cut short into Parquet files. Raises CosimError."""
    for rows in link_files(folder).values():
        if rows.suffix == ROWS:
            with _writing(rows):
                _convert(rows, rows.with_suffix(".parquet"))
                rows.unlink()


def save_table(path: str | Path, table: TableSpec, length: int) -> None:
    """Write the first `length` rows of a table. Raises ScenarioError if it has fewer."""
    path = Path(path)
    stream = table.stream(length)
    with TableWriter(path, table.facts()) as writer:
        for start in range(0, length, GROUP):
            writer.write(stream.rows(min(GROUP, length - start)))
