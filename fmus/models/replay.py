"""Playback of a recording: measured or simulated signals become the inputs of another run.

From the time of a row on, each output holds the row's value (zero-order hold). Before the first row
it holds the first value, and after the last row the last value::

    y(t) = row i,   t_i <= t < t_i+1

Source: own construction.

Sampled. The model exists in Python only, because a kernel reads no files. A scenario names a
function without arguments, in a module of the user, that creates the model::

    def operator():
        return Replay("session.parquet", {"tau_h": "master.tau_h"})

    [components.hand]
    model = "my_module:operator"

A recording is a run folder, a Parquet file with a column ``t`` (units in the columns' metadata), or
a CSV file as a run writes it, whose first line names the columns, including ``t`` (s). The entries
of a vector are the columns ``name[0]``, ``name[1]``.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.component import Kind, Parameter, Port
from cosim.base.errors import ScenarioError
from cosim.record import Run
from fmus.numeric import Array

if TYPE_CHECKING:
    from cosim.base.component import Outputs, Values

_ENTRY = re.compile(r"(.*)\[(\d+(?:, *\d+)*)\]$")


@final
class Replay:
    """Plays `signals` of the recording at `path`: name of the output -> name in the recording.

    `units`: of outputs; needed for CSV files, which contain none (default "1"), and not used for
    Parquet files. Raises ScenarioError, with the file and, if known, the line, for a recording that
    cannot be read or lacks a signal.
    """

    kind: Kind = "sampled"
    inputs: tuple[Port, ...] = ()
    parameters: tuple[Parameter, ...] = ()

    def __init__(
        self, path: str | Path, signals: Mapping[str, str], units: Mapping[str, str] | None = None
    ) -> None:
        self._path = Path(path)
        if self._path.suffix == ".csv":
            columns, known = _read_csv(self._path), dict(units or {})
            known = {column: known.get(name, "1") for name, column in signals.items()}
        else:
            run = Run.open(self._path)
            columns = {name: run.column(name) for name in _selected_columns(run.names, signals)}
            columns["t"], known = run.t, {column: run.unit(column) for column in signals.values()}
        self._t = _increasing(columns.pop("t"), self._path)
        self._rows = {
            name: _stacked(columns, column, self._path) for name, column in signals.items()
        }
        self.outputs: tuple[Port, ...] = tuple(
            Port(name, rows.shape[1:], known[signals[name]], f"{signals[name]} of the recording")
            for name, rows in self._rows.items()
        )

    def initialize(self, values: Values) -> None:
        """Go to the start; there is nothing to set."""

    def initial(self, u: Values) -> Outputs:
        """Outputs at the start: those of t = 0."""
        return self._at(0.0)

    def step(self, t: float, h: float, u: Values) -> Outputs:
        """Outputs as of `t` (s), which hold to t + h; t may be h / 10^6 short of a row's time."""
        return self._at(t + 1e-6 * h)

    def _at(self, t: float) -> Outputs:
        row = max(0, int(np.searchsorted(self._t, t, side="right")) - 1)
        return {name: rows[row] for name, rows in self._rows.items()}

    def get_state(self) -> object:
        """None: the outputs depend on time only."""
        return None

    def set_state(self, state: object) -> None:
        """Continue; there is nothing to go back to."""


def _selected_columns(names: tuple[str, ...], signals: Mapping[str, str]) -> list[str]:
    """Columns of `names` that belong to any of `signals`."""
    return [name for name in names if {name, name.partition("[")[0]} & set(signals.values())]


def _increasing(t: Array, path: Path) -> Array:
    if not t.size:
        raise ScenarioError("the recording has no rows", str(path))
    if not (np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise ScenarioError("column 't' is not increasing", str(path))
    return t


def _stacked(columns: Mapping[str, Array], name: str, path: Path) -> Array:
    """The signal `name`, (n, ...) for n rows. Raises ScenarioError."""
    if name in columns:
        stacked = columns[name]
    else:
        found = {_index(column): column for column in columns if _belongs(column, name)}
        if not found:
            raise ScenarioError(f"no signal {name!r}; there are: {', '.join(columns)}", str(path))
        shape = tuple(max(at) + 1 for at in zip(*found, strict=True))
        missing = [at for at in np.ndindex(shape) if at not in found]
        if missing:
            raise ScenarioError(f"{name} lacks its entry {list(missing[0])}", str(path))
        ordered = [columns[found[at]] for at in np.ndindex(shape)]
        stacked = np.stack(ordered, axis=1).reshape(-1, *shape)
    if not np.isfinite(stacked).all():
        row = int(np.argwhere(~np.isfinite(stacked))[0][0])
        raise ScenarioError(f"{name} is not finite in row {row}", str(path))
    return stacked


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
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"cannot be read: {error}", str(path)) from None
    if "t" not in names:
        raise ScenarioError(f"no column 't'; there are: {', '.join(names)}", str(path))
    table = np.array(rows, dtype=np.float64).reshape(-1, len(names))
    return dict(zip(names, table.T, strict=True))


def _numbers(row: list[str], n: int, place: str) -> list[float]:
    if len(row) != n:
        raise ScenarioError(f"{len(row)} entries, expected {n}", place)
    try:
        return [float(entry) for entry in row]
    except ValueError as error:
        raise ScenarioError(f"{error}", place) from None
