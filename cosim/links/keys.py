"""Keys of a link in a scenario: names of semantics; laws and loss models are structs.

The fields of such a struct are the keys of its table. A field has the unit of :data:`Seconds` or
:data:`Ratio`: a number as it is, a text with a unit that fits. :func:`read` makes a struct of a
table, with a message for what cannot be.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from importlib import import_module
from typing import Annotated, Any, Literal, get_args

import msgspec

from cosim.base.convert import Number, sentence
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import unknown
from cosim.base.units import quantity

Table = Mapping[str, Any]
Seconds = Annotated[float, msgspec.Meta(extra={"unit": "s"})]
Ratio = Annotated[float, msgspec.Meta(extra={"unit": "1"})]
Rate = Annotated[float, msgspec.Meta(extra={"unit": "1/s"})]


class Keyed(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="law"):
    """A law or a model that `law` names; its fields are the other keys, SI."""

    @classmethod
    def chosen(cls, table: Table) -> type[Keyed]:
        """The struct for these keys, where several have one name. Raises ScenarioError."""
        return cls

    @classmethod
    def completed(cls, table: Table) -> Table:
        """The table, SI, with the keys that may be left out and follow from others."""
        return table

    def facts(self) -> dict[str, Any]:
        """The metadata of a run: the name and its values, SI."""
        return {k: _listed(v) for k, v in msgspec.to_builtins(self).items()}


def _listed(value: Any) -> Any:
    return [_listed(x) for x in value] if isinstance(value, tuple) else value


def read(table: Table, modules: Mapping[str, str], key: str) -> Any:
    """The struct that a table called `key` describes.

    `modules`: by the name in `law`, the module of :mod:`cosim.links` and the class of its struct
    (``distributions:Gamma``), which is imported now. Raises ScenarioError.
    """
    if "law" not in table:
        raise ScenarioError("the key 'law' is missing", key)
    name = str(table["law"])
    if name not in modules:
        raise ScenarioError(unknown(name, modules, "kind"), f"{key}.law")
    module, _, found = modules[name].partition(":")
    struct: type[Keyed] = getattr(import_module(f"cosim.links.{module}"), found)
    struct = struct.chosen(table)
    units = _units(struct)
    plain = struct.completed({k: _in_unit(v, units.get(k, ""), k) for k, v in table.items()})
    try:
        return msgspec.convert(plain, struct)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, CosimError):
            raise error.__cause__ from None
        message, inside = sentence(error, struct, plain)
        raise ScenarioError(message, f"{key}{inside}") from None


@lru_cache(maxsize=64)
def _units(struct: type[Keyed]) -> dict[str, str]:
    return {f.encode_name: _unit(f.type) for f in msgspec.structs.fields(struct)}


def _unit(kind: Any) -> str:
    """The unit of a field's type, "" where its values are no texts."""
    own = [m.extra["unit"] for m in getattr(kind, "__metadata__", ())]
    return next((unit for unit in (*own, *map(_unit, get_args(kind))) if unit), "")


def _in_unit(value: Any, unit: str, name: str) -> Any:
    if unit and isinstance(value, list | tuple):
        return [_in_unit(x, unit, f"{name}[{i}]") for i, x in enumerate(value)]
    return si(value, name, unit) if unit and isinstance(value, str) else value


def si(value: Number, name: str, unit: str = "s") -> float:
    """A number as it is, a text in `unit`. Raises ScenarioError that calls it `name`."""
    if not isinstance(value, str):
        return float(value)
    try:
        return quantity(value, unit)
    except CosimError as error:
        raise ScenarioError(f"{name} = {value!r}: {error}") from None


#: Names of :mod:`cosim.links.semantics`.
Semantics = Literal["signal", "last-arrival", "newest-stamp", "fifo", "playout", "queue"]
#: The sample that a full queue drops, and what a look takes of it.
Drop = Literal["oldest", "newest"]
Take = Literal["one", "all"]
