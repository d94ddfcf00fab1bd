"""Copies of dataclasses and of structs (msgspec), whichever a value is.

The functions of these names in :mod:`dataclasses` refuse structs when they are called, which no
check of types sees; so nothing else calls them.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # names of fields are checked, those of structs too
    from dataclasses import asdict as asdict
    from dataclasses import replace as replace
else:

    def replace(value: Any, /, **changes: Any) -> Any:
        """The same with other values of some fields. Raises TypeError for a name of no field."""
        if dataclasses.is_dataclass(value):
            return dataclasses.replace(value, **changes)
        from msgspec import structs  # not where FMUs are built

        return structs.replace(value, **changes)

    def asdict(value: Any) -> dict[str, Any]:
        """The fields by name; the same of every dataclass and struct in them."""
        return {name: _plain(getattr(value, name)) for name in field_names(value)}


def field_names(kind: Any) -> tuple[str, ...]:
    """The names of the fields of a dataclass or a struct, or of its type; () of another."""
    if dataclasses.is_dataclass(kind):
        return tuple(field.name for field in dataclasses.fields(kind))
    return tuple(getattr(kind, "__struct_fields__", ()))


def _plain(value: Any) -> Any:
    if field_names(value):
        return asdict(value)
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if type(value) in (list, tuple):
        return type(value)(_plain(each) for each in value)
    return value
