"""The roles of a variants file, and the graph that defines from which roles each one receives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.comparison.toml import Section
from cosim.comparison.variants import Role
from cosim.scenario.connect import unknown


def read_roles(top: Section) -> dict[str, Role]:
    """The roles of a variants file. Of two roles each receives from the other; more must name it.

    Raises ScenarioError with the place of the error.
    """
    tables = dict(top.tables("roles"))
    if len(tables) < 2:
        found = ", ".join(tables)
        raise ScenarioError(f"expected at least two roles, found {found}", top.place("roles"))
    roles = {}
    for name, table in tables.items():
        table.only("arm", "controller", "hears")
        other = next(x for x in tables if x != name) if len(tables) == 2 else None
        heard = heard_roles(table, "hears", name, tables, other)
        roles[name] = Role(table.text("arm"), table.text("controller"), heard)
    return roles


def heard_roles(
    table: Section, key: str, name: str, known: Mapping[str, Any], default: str | None = None
) -> tuple[str, ...]:
    """The roles from which `name` receives: another one, or a list. Raises ScenarioError."""
    place = table.place(key)
    several = isinstance(table.data.get(key), list)
    heard = table.texts(key) if several else (table.text(key, default),)
    if not heard:
        raise ScenarioError("empty list; expected the roles from which it receives", place)
    for i, found in enumerate(heard):
        if found not in known:
            raise ScenarioError(unknown(found, known, "role"), place)
        if found == name:
            raise ScenarioError(f"{name} receives from itself; expected another role", place)
        if found in heard[:i]:
            raise ScenarioError(f"{found} twice; expected each role once", place)
    return heard
