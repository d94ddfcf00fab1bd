"""Sections of a TOML file with their position: every error names the file and the place in it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.base.convert import number
from cosim.base.errors import ScenarioError
from cosim.scenario.connect import unknown


@dataclass(frozen=True, slots=True)
class Section:
    """The table of `file` at `path`. Missing or invalid entries raise ScenarioError."""

    data: Mapping[str, Any]
    file: Path
    path: tuple[str, ...] = ()

    def __contains__(self, key: str) -> bool:
        """True if the key is given."""
        return key in self.data

    def place(self, *keys: str) -> str:
        """``FILE at controllers.pd.model``."""
        path = ".".join((*self.path, *keys))
        return f"{self.file} at {path}" if path else str(self.file)

    def only(self, *known: str) -> None:
        """Refuse any key that is not one of these."""
        for key in self.data:
            if key not in known:
                raise ScenarioError(unknown(key, known, "key"), self.place())

    def text(self, key: str, default: str | None = None) -> str:
        """A text; without a default it must be there."""
        found = self._get(key, default)
        if not isinstance(found, str):
            raise self._wrong(key, "a text", found)
        return found

    def flag(self, key: str) -> bool:
        """A Boolean, false if it is not there."""
        found = self._get(key, False)
        if not isinstance(found, bool):
            raise self._wrong(key, "true or false", found)
        return found

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        """A list of texts."""
        found = self._get(key, default)
        if not isinstance(found, list | tuple) or not all(isinstance(x, str) for x in found):
            raise self._wrong(key, "a list of texts", found)
        return tuple(found)

    def numbers(self, key: str, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """A list of numbers, in the unit of the key. Raises ScenarioError for anything else."""
        found = self._get(key, default)
        if not isinstance(found, list | tuple) or not all(_is_number(x) for x in found):
            raise self._wrong(key, "a list of numbers", found)
        return tuple(float(x) for x in found)

    def quantity(self, key: str, unit: str, default: float | None = None) -> float:
        """A number in `unit`, or a text with a unit that fits."""
        found = self._get(key, default)
        if not isinstance(found, str) and not _is_number(found):
            raise self._wrong(key, f"a number in {unit}", found)
        return number(found, unit, self.place(key))

    def mapping(self, key: str) -> dict[str, Any]:
        """A table as it is, empty if it is not there."""
        return dict(self.table(key).data)

    def table(self, key: str) -> Section:
        """A table below this one, empty if it is not there."""
        found = self._get(key, {})
        if not isinstance(found, dict):
            raise self._wrong(key, "a table", found)
        return Section(found, self.file, (*self.path, key))

    def tables(self, key: str) -> Iterator[tuple[str, Section]]:
        """The tables in a table, by name, in the order of the file; there must be one."""
        named = self.table(key)
        if not named.data:
            raise ScenarioError(f"empty table; expected a table [{key}.NAME]", self.place(key))
        return ((name, named.table(name)) for name in named.data)

    def _get(self, key: str, default: Any) -> Any:
        found = self.data.get(key, default)
        if found is None:
            raise ScenarioError(f"missing key {key!r}", self.place())
        return found

    def _wrong(self, key: str, expected: str, found: Any) -> ScenarioError:
        return ScenarioError(f"expected {expected}, found {found!r}", self.place(key))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
