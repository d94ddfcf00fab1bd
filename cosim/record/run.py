"""Run: a run folder read back. Columns are read when asked for, once."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any, TypeVar
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.base.errors import CutShort, ScenarioError
from cosim.base.files import written_aside
from cosim.record.folder import METADATA, TRAJECTORIES, is_unfinished, read_metadata, reason
from cosim.record.groups import numpy

Array = NDArray[np.float64]
T = TypeVar("T")

#: Bytes of the columns that are read together with one that is asked for.
AHEAD = 1 << 20
#: Values that are read at once, 8 MB: of a whole run, or of a piece of one with more.
PIECE = 1 << 20

_ENTRY = re.compile(r"(.+?)((?:\[[\d, ]+\])+)$")  # master.q[0], m.xi_in[1,0], m.xi_in[1][0]


class Run:
    """Trajectories of a run. Make one with :meth:`open`.

    ``run.t`` (n,) s; ``run.column("master.q[0]")`` (n,); ``run.array("master.q")`` (n, m).
    Arrays are read-only. Unknown names raise ScenarioError with the nearest known ones.
    """

    def __init__(self, path: Path, file: Any) -> None:
        self.path = path
        self._file = file
        schema = file.schema_arrow
        self._cache: dict[str, Array] = {}
        self._computed: dict[Hashable, Any] = {}
        self._kept: dict[str, Array] = {}  # of a long run, in the order of their last use
        self.units: Mapping[str, str] = {
            field.name: _text((field.metadata or {}).get(b"unit", b"1"), path) for field in schema
        }
        self.properties: Mapping[str, str] = {
            _text(key, path): _text(value, path)
            for key, value in (schema.metadata or {}).items()
            if key != b"ARROW:schema"
        }
        self._groups = _group(self.units)
        self._places = {name: i for i, name in enumerate(self.units)}
        self._metadata: tuple[int, dict[str, Any]] | None = None

    @classmethod
    def open(cls, folder: str | Path) -> Run:
        """Open a run folder, or a single trajectory file such as ``last.parquet``.

        A run that was cut short (killed, a full disk) is read as far as it was recorded, with the
        warning CutShort. Raises ScenarioError if there is none or it cannot be read.
        """
        place = Path(folder)
        path = place if place.is_file() else place / TRAJECTORIES
        if not place.exists():
            raise ScenarioError("there is no such run folder", str(place))
        if is_unfinished(place):
            return cls._recovered(path)
        if not path.exists():
            facts = read_metadata(place)
            why = facts.get("error") or "the run was cut short"
            text = f"nothing was recorded in this run ({why})" if facts else "not a run folder"
            raise ScenarioError(f"no {TRAJECTORIES} in this folder; {text}", str(place))
        import pyarrow.parquet as pq

        try:
            file = pq.ParquetFile(path)
        except (OSError, ValueError) as error:
            raise ScenarioError(
                f"not a complete Parquet file; the run may have been interrupted ({reason(error)})",
                str(path),
            ) from error
        if "t" not in file.schema_arrow.names:
            raise ScenarioError("found no column 't'; not the trajectories of a run", str(path))
        return cls(path, file)

    @classmethod
    def _recovered(cls, path: Path) -> Run:
        """An interrupted run, as far as it was recorded, with a warning."""
        from cosim.record.recover import is_recording, unfinished

        run = cls(path, unfinished(path.parent))
        what = "is still active" if is_recording(path.parent) else "was interrupted"
        until = f"is recorded until t = {run.span[1]:.6g} s" if len(run) else "contains no rows"
        warn(f"{path.parent}: the run {what}; it {until}", CutShort, stacklevel=3)
        return run

    # ---- signals -----------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the recorded scalars, in the order of the file, without ``t``."""
        return tuple(name for name in self.units if name != "t")

    @property
    def t(self) -> Array:
        """Time of each row, (n,), s: t_k = k·h."""
        return self.column("t")

    def __len__(self) -> int:
        """Number of rows."""
        return int(self._file.metadata.num_rows)

    def column(self, name: str) -> Array:
        """One recorded scalar, (n,)."""
        if name not in self.units:
            raise self._unknown(name)
        self._load([name])
        return self._cache[name]

    def array(self, prefix: str) -> Array:
        """All recorded entries of a signal, (n, m).

        ``"master.q"`` stacks ``master.q[0]``, ``master.q[1]`` and so on. A scalar, or one entry
        by its full name, is (n, 1). Entries come in the order of their indices (row-major),
        whatever their order in the file.
        """
        names = self.entries(prefix)
        self._load(list(names))
        stacked = np.stack([self._cache[name] for name in names], axis=1)
        stacked.flags.writeable = False
        return stacked

    def pieces(
        self, prefixes: Sequence[str], since: float = -inf, *, backwards: bool = False
    ) -> Iterator[Run | RunPiece]:
        """The rows in order, in pieces of which each has `t` and these signals or entries.

        A small run is one piece, the run itself. Pieces that end before the time `since`, s, are
        left out; `backwards`: the last piece comes first. Memory does not depend on the number of
        rows.
        """
        names = list(dict.fromkeys(name for prefix in prefixes for name in self.entries(prefix)))
        if not self.is_long:
            self._load(["t", *names])
            yield self
            return
        if (1 + len(names)) * len(self) <= PIECE:
            piece = self._recent(names)
            if len(piece.t) and since <= piece.t[-1]:
                yield piece
            return
        together = list(self._together(PIECE // (1 + len(names))))
        for groups in reversed(together) if backwards else together:
            yield from self._piece(groups, names, since)

    def _recent(self, names: Sequence[str]) -> RunPiece:
        """All rows of columns that fit into a piece, read-only.

        As many of the columns that were used last are kept. Raises ScenarioError.
        """
        wanted = dict.fromkeys(("t", *names))
        missing = [name for name in wanted if name not in self._kept]
        if missing:
            self._kept |= self._read([*range(self._file.num_row_groups)], missing)
        columns = {name: self._kept.pop(name) for name in wanted}
        for values in columns.values():
            values.flags.writeable = False
        self._kept |= columns
        for name in [*self._kept][: -(PIECE // max(1, len(self)))]:
            del self._kept[name]
        return RunPiece(self, columns["t"], columns)

    def _together(self, most: int) -> Iterator[list[int]]:
        """Row groups that are read together: those that follow each other, with `most` rows."""
        at, groups = 0, list[int]()
        for group in range(self._file.num_row_groups):
            rows = self._file.metadata.row_group(group).num_rows
            if groups and at + rows > most:
                yield groups
                at, groups = 0, []
            at, groups = at + rows, [*groups, group]
        yield groups

    def _piece(self, groups: list[int], names: list[str], since: float) -> Iterator[RunPiece]:
        if since > -inf and since > self._read(groups[-1:], ["t"])["t"][-1]:
            return
        columns = self._read(groups, list(dict.fromkeys(["t", *names])))
        yield RunPiece(self, columns["t"], columns)

    def _read(self, groups: list[int], names: list[str]) -> dict[str, Array]:
        """Columns of row groups, read a piece at a time. Raises ScenarioError."""
        rows = sum(self._file.metadata.row_group(group).num_rows for group in groups)
        most, found = max(1, PIECE // max(1, rows)), dict[str, Array]()
        for at in range(0, len(names), most):
            some = names[at : at + most]
            try:
                table = self._file.read_row_groups(groups, columns=some, use_threads=False)
            except (OSError, ValueError) as error:
                raise ScenarioError(f"cannot be read: {reason(error)}", str(self.path)) from error
            found |= {name: numpy(table.column(name), np.float64) for name in some}
        return found

    def once(self, of: Hashable, compute: Callable[[], T]) -> T:
        """The result of `compute` from the trajectories, computed at the first request for `of`."""
        if of not in self._computed:
            self._computed[of] = compute()
        found: T = self._computed[of]
        return found

    @property
    def columns_at_once(self) -> int:
        """Columns, one at least, of which a row group is no more than a piece, with its times."""
        metadata = self._file.metadata
        rows = metadata.row_group(0).num_rows if metadata.num_row_groups else 0
        return max(1, PIECE // max(1, rows) - 1)

    @property
    def is_long(self) -> bool:
        """True if the run is read in pieces."""
        return len(self) * len(self.units) > PIECE

    @property
    def span(self) -> tuple[float, float]:
        """Times of the first and the last row, s; there must be one."""
        if not self.is_long:
            return float(self.t[0]), float(self.t[-1])
        if len(self) <= PIECE:
            t = self._recent(()).t
            return float(t[0]), float(t[-1])
        last = self._file.num_row_groups - 1
        return float(self._read([0], ["t"])["t"][0]), float(self._read([last], ["t"])["t"][-1])

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of the scalars that :meth:`array` stacks."""
        if prefix in self.units:
            return (prefix,)
        if prefix not in self._groups:
            raise self._unknown(prefix)
        return self._groups[prefix]

    def has(self, prefix: str) -> bool:
        """True if a signal, or one entry by its full name, was recorded."""
        return prefix in self.units or prefix in self._groups

    def unit(self, prefix: str) -> str:
        """Unit of a signal, or of one entry. Raises ScenarioError if entries differ in it."""
        from cosim.record.signals import only_unit

        return only_unit({name: self.units[name] for name in self.entries(prefix)}, str(self.path))

    def _load(self, names: list[str]) -> None:
        missing = [name for name in names if name not in self._cache]
        if not missing:
            return
        missing = self._with_those_behind(missing)
        try:
            table = self._file.read(columns=missing, use_threads=False)
        except (OSError, ValueError) as error:
            raise ScenarioError(f"cannot be read: {reason(error)}", str(self.path)) from error
        for name in missing:
            values = numpy(table.column(name), np.float64)
            values.flags.writeable = False
            self._cache[name] = values

    def _with_those_behind(self, names: list[str]) -> list[str]:
        """Also the next columns that are not there yet: one by one, each takes as long as many."""
        more = AHEAD // (8 * max(1, len(self))) - len(names)
        if more <= 0:
            return names
        behind = islice(self.units, self._places[names[-1]] + 1, None)
        wanted = (name for name in behind if name not in self._cache)
        return [*dict.fromkeys([*names, *islice(wanted, more)])]

    def _unknown(self, name: str) -> ScenarioError:
        known = [*self._groups, *self.units]
        from difflib import get_close_matches

        near = get_close_matches(name, known, n=3, cutoff=0.5)
        hint = f"; did you mean {' or '.join(map(repr, near))}?" if near else ""
        if not hint:
            shown = ", ".join(list(self._groups)[:8]) + (", …" if len(self._groups) > 8 else "")
            hint = f"; recorded are {shown or 'no signals'}"
        return ScenarioError(f"no signal {name!r} was recorded{hint}", str(self.path))

    # ---- beside the signals ------------------------------------------------------------------

    @property
    def metadata(self) -> dict[str, Any]:
        """``run.json``; empty if the run did not get as far as writing it.

        Read again when it has changed.
        """
        folder = self.path.parent
        try:
            changed = (folder / METADATA).stat().st_mtime_ns
        except OSError:
            return read_metadata(folder)
        if self._metadata is None or self._metadata[0] != changed:
            self._metadata = changed, read_metadata(folder)
        return self._metadata[1]

    @property
    def link_tables(self) -> Mapping[str, Path]:
        """File of each stored link table, by link name."""
        from cosim.record.recover import stored_tables

        return stored_tables(self.path.parent)

    def to_csv(self, path: str | Path, names: Sequence[str] = ()) -> Path:
        """Write CSV: a line of names, then numbers that read back exactly.

        `names` of the scalars to write besides ``t``; empty: all. Raises RunError with the path.
        """
        import pyarrow.csv as csv

        return self._write(csv.CSVWriter, Path(path), names)

    def to_parquet(self, path: str | Path, names: Sequence[str] = ()) -> Path:
        """Write Parquet, with the unit of each column in its metadata; otherwise as `to_csv`."""
        import pyarrow.parquet as pq

        return self._write(pq.ParquetWriter, Path(path), names)

    def _write(self, writer: Any, path: Path, names: Sequence[str]) -> Path:
        """Write row groups one by one, so that a long run need not fit into memory."""
        import pyarrow as pa

        chosen = ["t", *(names or self.names)]
        schema = self._file.schema_arrow
        kept = pa.schema([schema.field(name) for name in chosen], schema.metadata)
        with written_aside(path) as part, writer(str(part), kept) as file:
            for i in range(self._file.num_row_groups):
                file.write_table(self._file.read_row_group(i, columns=chosen).select(chosen))
        return path


class RunPiece(Struct, frozen=True):
    """Some rows of a run: `t` (n,), s, and the columns that were asked for, (n,) each."""

    run: Run
    t: Array
    columns: Mapping[str, Array]

    def column(self, name: str) -> Array:
        """One of the columns, (n,), in its unit."""
        return self.columns[name]

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""
        return np.stack([self.columns[name] for name in self.entries(prefix)], axis=1)

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of those entries."""
        return self.run.entries(prefix)

    def unit(self, prefix: str) -> str:
        """Unit of a signal. Raises ScenarioError if its entries differ in it."""
        return self.run.unit(prefix)


def _text(data: bytes, path: Path) -> str:
    """A unit or property of a trajectory file. Raises ScenarioError."""
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise ScenarioError(f"found {data[:40]!r}; expected UTF-8: {error}", str(path)) from None


def _group(names: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Scalars by the signal they are entries of, in the order of their indices."""
    found: dict[str, list[tuple[tuple[int, ...], str]]] = {}
    for name in names:
        match = _ENTRY.match(name)
        key = match[1] if match else name
        index = tuple(map(int, re.findall(r"\d+", match[2]))) if match else ()
        if name != "t":
            found.setdefault(key, []).append((index, name))
    return {key: tuple(name for _, name in sorted(entries)) for key, entries in found.items()}
