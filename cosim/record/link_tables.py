"""The tables of many links in one file of a run folder: ``links.parquet``, a row for each link.

Its columns: `link`, the name; `facts`, a JSON text; `sent`, the list of samples held (int32). While
a run writes it, it is ``links.rows``: a line of JSON with the names; then blocks of int32, each the
number of rows of every link and then these rows, link after link. A process that was killed leaves
all blocks that it wrote. The table of one link has a path in either: ``links.parquet/NAME``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote, unquote

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import Closing
from cosim.record.folder import TABLE_ROWS, TABLES, read_metadata, reason
from cosim.record.groups import arrow, numpy

#: Links of a run from which on their tables are in one file: each file costs more than a table.
MANY = 256
#: Links in a row group, and rows of these, at most: one is read as a whole.
_GROUP, _GROUP_ROWS = 64, 1 << 21
Rows = NDArray[np.int32]


class TablesWriter(Closing):
    """Writes the tables of all links of a run; `facts`: of each link, by name, for its replay.

    Raises RunError with the path where the file cannot be written.
    """

    def __init__(self, folder: Path, facts: Mapping[str, Mapping[str, Any]]) -> None:
        self._folder, self._facts = folder, facts
        self._path = folder / TABLE_ROWS
        first = json.dumps(list(facts)).encode()
        part = self._path.with_name(f"{TABLE_ROWS}.part")
        try:
            self._file: BinaryIO = part.open("wb", buffering=1 << 20)
            self._file.write(first + b" " * (-(len(first) + 1) % 4) + b"\n")
            self._file.flush()
            part.replace(self._path)
        except OSError as error:
            raise self._error(error) from error

    def write(self, rows: Rows, counts: NDArray[np.int64]) -> None:
        """Append the next rows of all links, one link after the other, `counts` (links,) each."""
        try:
            self._file.write(np.ascontiguousarray(counts, "<i4").data)
            self._file.write(np.ascontiguousarray(rows, "<i4").data)
            self._file.flush()
        except OSError as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Make the Parquet file, and delete the one it was made from."""
        try:
            self._file.close()
            complete(self._folder, self._facts)
        except OSError as error:
            raise self._error(error) from error

    def _error(self, error: OSError) -> RunError:
        return RunError(f"cannot write {self._path}: {reason(error)}")


def complete(folder: Path, facts: Mapping[str, Mapping[str, Any]]) -> None:
    """Make ``links.parquet`` of ``links.rows``. Raises OSError."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    blocks = _Blocks(folder / TABLE_ROWS)
    fields = {"link": pa.string(), "facts": pa.string(), "sent": pa.list_(pa.int32())}
    schema = pa.schema([pa.field(name, kind, nullable=False) for name, kind in fields.items()])
    part = folder / f"{TABLES}.part"
    settings = {
        "compression": "zstd", "use_dictionary": False,
        "column_encoding": {"sent.list.element": "DELTA_BINARY_PACKED"},
    }  # fmt: skip
    with pa.OSFile(str(part), "wb") as sink, pq.ParquetWriter(sink, schema, **settings) as writer:
        for names in blocks.together():
            rows = blocks.rows_of(names)
            ends = np.cumsum([0, *map(len, rows)], dtype=np.int32)
            columns = [
                pa.array(names, pa.string()),
                pa.array([_text(facts.get(name, {})) for name in names], pa.string()),
                pa.ListArray.from_arrays(arrow(ends), arrow(np.concatenate(rows))),
            ]
            writer.write_table(pa.table(columns, schema=schema))
    part.replace(folder / TABLES)
    (folder / TABLE_ROWS).unlink()


def table_paths(folder: Path) -> Mapping[str, Path]:
    """The path of each link's table in the file of all, by name, sorted by name."""
    for path in (folder / TABLES, folder / TABLE_ROWS):
        if path.is_file():
            return _Paths(path, sorted(_opened(path, path.stat().st_mtime_ns).names))
    return {}


class _Paths(Mapping[str, Path]):
    """Paths in a file of many tables, made when they are asked for."""

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        self._path, self._names = path, dict.fromkeys(names)

    def __getitem__(self, name: str) -> Path:
        if name not in self._names:
            raise KeyError(name)
        return self._path / quote(name, safe=" ")

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def is_together(path: Path) -> bool:
    """True if it is the path of a table in a file of many."""
    return path.parent.name in (TABLES, TABLE_ROWS) and path.parent.is_file()


def table_facts(path: Path) -> tuple[str, int]:
    """The text of the facts, and the number of rows. Raises ScenarioError."""
    text, rows = _table(path)
    return text, len(rows)


def table_rows(path: Path) -> Rows:
    """All rows (n,). Raises ScenarioError."""
    return _table(path)[1]


def _table(path: Path) -> tuple[str, Rows]:
    name = unquote(path.name)
    there = _opened(path.parent, path.parent.stat().st_mtime_ns)
    if name not in there.places:
        raise ScenarioError(f"no table of the link {name!r}", str(path.parent))
    return there.text(name), there.rows(name)


@lru_cache(maxsize=2)
def _opened(path: Path, changed: int) -> _Blocks | _Finished:
    """The file as it was when it was `changed` (ns). Raises ScenarioError if it is damaged."""
    del changed  # decides whether it must be opened anew
    try:
        return _Finished(path) if path.name == TABLES else _Blocks(path)
    except (OSError, ValueError, KeyError) as error:  # pyarrow's errors derive from these
        raise ScenarioError(f"not a file of link tables ({error})", str(path)) from None


class _Blocks:
    """``links.rows``; a block that is not complete is left out."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            line = file.readline()
        self.names: Sequence[str] = json.loads(line)
        self.places = {name: i for i, name in enumerate(self.names)}
        self._path, self._blocks = path, list[tuple[int, NDArray[np.int64]]]()
        at, n, size = len(line) // 4, len(self.names), path.stat().st_size // 4
        with path.open("rb", buffering=0) as file:
            while n and at + n <= size:
                ends = np.cumsum(_read(file, at, n), dtype=np.int64)
                if at + n + ends[-1] > size:
                    break
                self._blocks.append((at + n, np.r_[0, ends]))
                at += n + int(ends[-1])

    def together(self) -> Iterator[Sequence[str]]:
        """Names of links whose rows are in one row group."""
        lengths = sum((np.diff(ends) for _, ends in self._blocks), np.zeros(len(self.names), int))
        longest = int(max(lengths, default=0))
        count = min(_GROUP, max(1, _GROUP_ROWS // max(1, longest)))
        for first in range(0, len(self.names), count):
            yield self.names[first : first + count]

    def rows(self, name: str) -> Rows:
        """The rows of a link, as far as they are written."""
        return self.rows_of([name])[0]

    def rows_of(self, names: Sequence[str]) -> list[Rows]:
        """The rows of links that follow each other."""
        first = self.places[names[0]]
        parts: list[list[Rows]] = [[np.empty(0, np.int32)] for _ in names]
        with self._path.open("rb", buffering=0) as file:
            for at, ends in self._blocks:
                own = ends[first : first + len(names) + 1]
                read = _read(file, at + int(own[0]), int(own[-1] - own[0]))
                for part, rows in zip(parts, np.split(read, own[1:-1] - own[0]), strict=True):
                    part.append(rows)
        return [np.concatenate(part) for part in parts]

    def text(self, name: str) -> str:
        """The facts, which are in ``run.json`` until the file is complete."""
        return _text(self._facts.get(name, {}))

    @cached_property
    def _facts(self) -> Mapping[str, Any]:
        found: Mapping[str, Any] = read_metadata(self._path.parent).get("links", {})
        return found


def _read(file: FileIO, at: int, count: int) -> Rows:
    """Numbers from a place on. Pages of a mapped file would count as memory of the process."""
    file.seek(4 * at)
    return np.frombuffer(file.read(4 * count), "<i4")


class _Finished:
    """``links.parquet``."""

    def __init__(self, path: Path) -> None:
        import pyarrow.parquet as pq

        self._file = pq.ParquetFile(path, memory_map=True)
        self.names: Sequence[str] = self._file.read(columns=["link"]).column(0).to_pylist()
        self.places = {name: i for i, name in enumerate(self.names)}
        self._starts = list(self._group_starts())
        self._read: dict[str, tuple[int, Any]] = {}  # by column, the row group that was read last

    def _group_starts(self) -> Iterator[int]:
        at = 0
        for group in range(self._file.num_row_groups):
            yield at
            at += self._file.metadata.row_group(group).num_rows

    def _row(self, name: str, column: str) -> Any:
        i = self.places[name]
        group = int(np.searchsorted(self._starts, i, side="right")) - 1
        if self._read.get(column, (-1,))[0] != group:
            table = self._file.read_row_group(group, columns=[column])
            self._read[column] = group, table.column(0)
        return self._read[column][1].slice(i - self._starts[group], 1)

    def rows(self, name: str) -> Rows:
        """The rows of a link."""
        import pyarrow as pa

        chunks = self._row(name, "sent").chunks
        return numpy(pa.chunked_array([x.flatten() for x in chunks], pa.int32()), np.int32)

    def text(self, name: str) -> str:
        """Its facts."""
        return str(self._row(name, "facts")[0].as_py())


def _text(facts: Mapping[str, Any]) -> str:
    return json.dumps(facts, sort_keys=True, allow_nan=False)
