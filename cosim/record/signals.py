"""Recorded signals by name, stacked and checked, for metrics and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.units import parse

Array = NDArray[np.float64]


class Signals(Protocol):
    """Recorded signals; :class:`cosim.record.Run` is one. Unknown names raise ScenarioError."""

    @property
    def t(self) -> Array:
        """Time of each row, (n,), s, ascending."""

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of those entries, (m,)."""

    def unit(self, prefix: str) -> str:
        """Unit of a signal. Raises ScenarioError if its entries differ in it."""


def only_unit(units: Mapping[str, str], place: str = "") -> str:
    """The unit of entries, given by their names. Raises ScenarioError at `place` for several."""
    first = next(iter(units))
    for name, unit in units.items():
        if unit != units[first]:
            raise ScenarioError(
                f"{first} is in [{units[first]}] but {name} is in [{unit}]; expected entries of "
                "one unit, by their names",
                place,
            )
    return units[first]


class Stack(Struct, frozen=True):
    """Signals side by side: `t` (n,) s, `x` (n, m) in `unit`, `names` (m,) of the columns."""

    t: Array
    x: Array
    unit: str
    names: tuple[str, ...]

    @property
    def problem(self) -> str:
        """The reason why there is no number, as a sentence; empty if there is one."""
        if not len(self.t):
            return "nothing was recorded"
        finite = np.isfinite(self.x)
        if finite.all():
            return ""
        bad = ~finite
        row = int(np.argmax(bad.any(axis=1)))
        name = self.names[int(np.argmax(bad[row]))]
        return f"{name} is {self.x[row, self.names.index(name)]} at {self.t[row]:.6g} s"


def stack(signals: Signals, names: Sequence[str], place: str) -> Stack:
    """The named signals side by side. Raises ScenarioError at `place`.

    They must have been recorded, have the same number of rows and the same unit.
    """
    try:
        arrays = [np.asarray(signals.array(name), dtype=np.float64) for name in names]
        units = [signals.unit(name) for name in names]
        columns = tuple(entry for name in names for entry in signals.entries(name))
        for name, unit in zip(names, units, strict=True):
            if parse(unit) != parse(units[0]):
                raise ScenarioError(f"{names[0]} is in [{units[0]}] but {name} is in [{unit}]")
    except CosimError as error:
        raise ScenarioError(str(error), place) from error
    t = np.asarray(signals.t, dtype=np.float64)
    for name, array in zip(names, arrays, strict=True):
        if len(array) != len(t):
            raise ScenarioError(f"{name} has {len(array)} rows, the time has {len(t)}", place)
    x = arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=1)
    return Stack(t, x, units[0], columns)
