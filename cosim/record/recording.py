"""Signals over time from a file: a run folder, a Parquet file, or a CSV file."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.base.names import signal_of, unknown
from cosim.record.run import Run

Array = NDArray[np.float64]
#: Names that the column of the time may have in a CSV file.
TIME = ("t", "time")
_ENTRY = re.compile(r"(.*)\[(\d+(?:, *\d+)*)\]$")


@dataclass(frozen=True, slots=True)
class Recording:
    """The columns of a file by name, (n,) each, at times `t` (n,), s.

    `units` of the columns where the file contains any: CSV files do not.
    """

    path: Path
    t: Array
    columns: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(
        cls, path: str | Path, wanted: tuple[str, ...] | None = None, *, jumps: bool = False
    ) -> Recording:
        """Read a run folder, a Parquet file with a column ``t``, or a CSV file with ``t`` or
        ``time``, whose first line names its columns.

        `wanted`: signals that are needed; None: all. `jumps`: a time may stand in several rows, the
        first one with the values before it, the last one with those from it on. Raises
        ScenarioError, with the file and, if known, the line, for what cannot be read, and for
        times that do not increase.
        """
        path = Path(path)
        if path.suffix == ".csv":
            columns = _read_csv(path)
            t = columns.pop(_time(columns, path))
            return cls(path, _increasing(t, path, jumps=jumps), columns)
        run = Run.open(path)
        names = run.names if wanted is None else _selected(run.names, wanted)
        columns = {name: run.column(name) for name in names}
        return cls(path, _increasing(run.t, path, jumps=jumps), columns, dict(run.units))

    def signal(self, name: str, base: int | None = None) -> Array:
        """The signal `name`, (n, ...): one column, or stacked from ``name[0]``, ``name[1]`` ...

        `base`: the index of its first entry, 0 or 1; None: as the file has it. Raises ScenarioError
        if it is absent, lacks an entry, or is not finite.
        """
        stacked = self.columns[name] if name in self.columns else self._stacked(name, base)
        if not np.isfinite(stacked).all():
            row = int(np.argwhere(~np.isfinite(stacked))[0][0])
            raise ScenarioError(f"{name} is not finite in row {row}", str(self.path))
        return stacked

    def unit(self, name: str) -> str | None:
        """The unit of a signal, or None where the file says none. Raises ScenarioError."""
        found = {u for c, u in self.units.items() if c == name or _belongs(c, name)}
        if len(found) > 1:
            text = f"{name} has several units: {', '.join(sorted(found))}"
            raise ScenarioError(text, str(self.path))
        return found.pop() if found else None

    def _stacked(self, name: str, base: int | None) -> Array:
        found = {_index(column): column for column in self.columns if _belongs(column, name)}
        if not found:
            raise ScenarioError(unknown(name, self.columns, "signal"), str(self.path))
        least = min(min(at) for at in found)
        first = min(least, 1) if base is None else base
        if least < first:
            text = f"{name} has an entry [{least}]; expected entries from [{first}] on"
            raise ScenarioError(text, str(self.path))
        shape = tuple(max(at) + 1 - first for at in zip(*found, strict=True))
        entries = [tuple(i + first for i in at) for at in np.ndindex(shape)]
        missing = [at for at in entries if at not in found]
        if missing:
            raise ScenarioError(f"{name} lacks its entry {list(missing[0])}", str(self.path))
        ordered = [self.columns[found[at]] for at in entries]
        return np.stack(ordered, axis=1).reshape(-1, *shape)


def _selected(names: tuple[str, ...], wanted: tuple[str, ...]) -> list[str]:
    """Columns of `names` that belong to any wanted signal."""
    return [name for name in names if {name, signal_of(name)} & set(wanted)]


def _time(columns: dict[str, Array], path: Path) -> str:
    found = next((name for name in TIME if name in columns), None)
    if found is None:
        raise ScenarioError(f"no column 't'; there are: {', '.join(columns)}", str(path))
    return found


def _increasing(t: Array, path: Path, *, jumps: bool) -> Array:
    if not t.size:
        raise ScenarioError("the recording has no rows", str(path))
    steps = np.diff(t)
    if not (np.isfinite(t).all() and ((steps >= 0) if jumps else (steps > 0)).all()):
        raise ScenarioError("column 't' is not increasing", str(path))
    return t


def _belongs(column: str, name: str) -> bool:
    match = _ENTRY.match(column)
    return match is not None and match[1] == name


def _index(column: str) -> tuple[int, ...]:
    match = _ENTRY.match(column)
    return tuple(int(i) for i in match[2].split(",")) if match else ()


def _read_csv(path: Path) -> dict[str, Array]:
    """Columns by name. Raises ScenarioError with the line."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.reader(file)
            names = [name.strip() for name in next(reader, [])]
            rows = [_numbers(row, len(names), f"{path}:{reader.line_num}") for row in reader if row]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(f"cannot be read: {error}", str(path)) from None
    table = np.array(rows, dtype=np.float64).reshape(-1, len(names))
    return dict(zip(names, table.T, strict=True))


def _numbers(row: list[str], n: int, place: str) -> list[float]:
    if len(row) != n:
        raise ScenarioError(f"{len(row)} entries, expected {n}", place)
    try:
        return [float(entry) for entry in row]
    except ValueError as error:
        raise ScenarioError(f"{error}", place) from None
