"""Data of an interrupted run: read directly, or completed to a regular file.

No cooperation of the writer is needed: the row groups in ``trajectories.parquet.part``, the rows in
``trajectories.live`` and the rows of link tables exist however and whenever the process ended.
Ticks that are in two of the files are used once. :mod:`bridge.recording.recovered` makes the
trajectories and link tables of nodes from their journals.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile, gettempdir
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import RunError, ScenarioError
from cosim.base.parts import part
from cosim.record.folder import (
    LAST,
    LIVE,
    PART,
    TRAJECTORIES,
    is_unfinished,
    journals,
    link_files,
    reason,
)
from cosim.record.groups import SETTINGS, batch, schema
from cosim.record.link_tables import table_paths
from cosim.record.live import Column, Live, Rows, in_use

#: What is collected of the journals of a run that was cut short.
SCRATCH = ".recovered"
#: What was collected for readers, by the journals it was collected of; it goes with this process.
_collections: dict[object, TemporaryDirectory[str]] = {}


def is_recording(folder: Path) -> bool:
    """True if a process still records into the folder."""
    return any(in_use(path) for path in (folder / LIVE, *journals(folder)))


def stored_tables(folder: Path) -> Mapping[str, Path]:
    """The stored link tables of a folder: path by link name, sorted by name.

    For interrupted nodes, the tables according to their journals.
    """
    whole = journals(folder) and is_unfinished(folder)
    place = _collected(folder) if whole else folder
    return link_files(place) or table_paths(place)


def _collected(folder: Path) -> Path:
    """Trajectories and link tables of the journals in `folder`, in a folder for this process.

    They are collected once, or at each request while the run is active.
    """
    there = [(path, path.stat()) for path in journals(folder)]
    stamps = frozenset((path.resolve(), found.st_ino, found.st_mtime_ns) for path, found in there)
    key = object() if is_recording(folder) else stamps
    if key not in _collections:
        scratch = TemporaryDirectory(prefix="cosim-", ignore_cleanup_errors=True)
        part("recordings").collect(folder, Path(scratch.name))
        _collections[key] = scratch
    return Path(_collections[key].name)


def unfinished(folder: Path) -> Any:
    """The trajectories of an unfinished folder, as an open Parquet file.

    They are in a temporary file, which goes with that. Raises ScenarioError if they are damaged,
    RunError if there is no room.
    """
    import pyarrow.parquet as pq

    if journals(folder):
        return pq.ParquetFile(_collected(folder) / TRAJECTORIES)
    try:
        file = TemporaryFile(prefix="cosim-")  # noqa: SIM115 (closed with the Parquet file)
        _write(folder, file)
        file.seek(0)
        return pq.ParquetFile(file)
    except OSError as error:
        raise RunError(
            f"cannot write a copy of {folder / PART} in {gettempdir()}: {reason(error)};"
            " expected room there, or cosim report RUN --recover"
        ) from error


def complete(folder: Path) -> None:
    """Write ``trajectories.parquet`` and ``last.parquet`` of an unfinished folder.

    Their source files are deleted afterwards; journals of nodes remain, and give link tables as
    well. Raises ScenarioError if the journals are damaged or the run is active, RunError if nothing
    can be written.
    """
    import pyarrow as pa

    if is_recording(folder):
        raise ScenarioError("the run is still active; there is nothing to recover", str(folder))
    if journals(folder):
        _complete_nodes(folder)
        return
    scratch, last = (folder / f"{name}.recovered" for name in (TRAJECTORIES, LAST))
    try:
        with pa.OSFile(str(scratch), "wb") as sink:
            _write(folder, sink)
        if _write_last(folder, last):
            last.replace(folder / LAST)
        scratch.replace(folder / TRAJECTORIES)
        for name in (LIVE, PART):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        for path in (scratch, last):
            path.unlink(missing_ok=True)
        raise RunError(f"cannot write {folder / TRAJECTORIES}: {reason(error)}") from error


def _complete_nodes(folder: Path) -> None:
    """Collect journals in a separate folder, then move the results into place file by file."""
    scratch = folder / SCRATCH
    shutil.rmtree(scratch, ignore_errors=True)
    try:
        scratch.mkdir()
        part("recordings").collect(folder, scratch)
        found = [path for path in scratch.rglob("*") if path.is_file()]
        for path in sorted(found, key=lambda p: p.name == TRAJECTORIES):  # last: then all is there
            place = folder / path.relative_to(scratch)
            place.parent.mkdir(exist_ok=True)
            path.replace(place)
        for name in (LIVE, PART):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise RunError(f"cannot write {folder / TRAJECTORIES}: {reason(error)}") from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _write(folder: Path, sink: Any) -> None:
    import pyarrow.parquet as pq

    live = Live.read(folder / LIVE)
    said = live.layout
    fields = schema(said.columns, said.h, said.every, said.metadata)
    with pq.ParquetWriter(sink, fields, **SETTINGS) as writer:
        for group in _groups(folder, live):
            writer.write_batch(batch(group, fields), said.group)


def _groups(folder: Path, live: Live) -> Iterator[NDArray[np.float64]]:
    """Everything recorded, (columns + 1, rows) each; row 0 is t. No row group is larger than full.

    Rows in the group and in the chunks may be those of the file, or of the group, as well.
    """
    from cosim.record.pages import groups

    said = live.layout
    written, filled = (int(n) for n in live.counts)
    last = -1
    for found in groups(folder / PART, len(live.group), said.group, written // said.group):
        yield found
        last = int(said.ticks(found[0, -1:])[0])
    rest = live.group[:, :filled]
    rest = rest[:, said.ticks(rest[0]) > last]
    if rest.size:
        last = int(said.ticks(rest[0, -1:])[0])
    for k0, rows in _chunks(live):
        ticks = np.arange(k0, k0 + len(rows))
        newest = (ticks == _newest(live)) & (not said.sparse)
        kept = (ticks > last) & ((ticks % said.every == 0) | newest)
        rest = np.concatenate([rest, _columns(live, ticks[kept], rows[kept])], axis=1)
    for first in range(0, rest.shape[1], said.group):
        yield np.ascontiguousarray(rest[:, first : first + said.group])


def _columns(live: Live, ticks: NDArray[np.int64], rows: Rows) -> NDArray[np.float64]:
    index = np.array([column.index for column in live.layout.columns], dtype=np.intp)
    return np.concatenate([live.layout.times(ticks)[None], rows.T[index]])


def _chunks(live: Live) -> list[tuple[int, Rows]]:
    """First tick and rows of the chunks, in order, without empty ones."""
    spans = sorted((int(k0), int(n), i) for i, (k0, n) in enumerate(live.spans) if n > 0)
    return [(k0, live.chunks[i][:n]) for k0, n, i in spans]


def _newest(live: Live) -> int:
    """The last tick that was recorded."""
    return max((k0 + len(rows) for k0, rows in _chunks(live)), default=0) - 1


def _write_last(folder: Path, output: Path) -> bool:
    """The last ticks of all signals, as far as the chunks reach back; False: there are none."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    live = Live.read(folder / LIVE)
    chunks = _chunks(live)
    if not live.layout.everything or not chunks:
        return False
    rows = np.concatenate([rows for _, rows in chunks])
    ticks = np.concatenate([np.arange(k0, k0 + len(rows)) for k0, rows in chunks])
    if live.layout.sparse:
        kept = ticks % live.layout.every == 0
        rows, ticks = rows[kept], ticks[kept]
    everything: tuple[Column, ...] = live.layout.everything
    fields = schema(everything, live.layout.h, 1, live.layout.metadata)
    index = np.array([column.index for column in everything], dtype=np.intp)
    values = np.concatenate([live.layout.times(ticks)[None], rows.T[index]])
    with (
        pa.OSFile(str(output), "wb") as sink,
        pq.ParquetWriter(sink, fields, **SETTINGS) as writer,
    ):
        writer.write_batch(batch(np.ascontiguousarray(values), fields))
    return True
