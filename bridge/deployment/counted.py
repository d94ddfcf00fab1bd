"""Many of a kind in a deployment: ``[nodes.NAME]`` and ``[messages.NAME]`` with ``count``.

``[nodes.node]`` with ``count = 50`` becomes ``node1`` to ``node50``, as components of a scenario do
(:mod:`cosim.scenario.arrays`): in its texts ``{i}`` is the number, from 1.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.base.errors import ScenarioError
from cosim.scenario.placeholders import filled

#: Numbers of nodes that a Zenoh bus has room for, and that a CAN bus has.
MOST, MOST_ON_CAN = 2000, 31
#: Tables of a deployment whose entries may be counted.
TABLES = ("nodes", "messages")


def expand_counted(document: dict[str, Any], path: Path) -> None:
    """Replace counted nodes and messages of a parsed deployment by single ones, in place.

    Raises ScenarioError for a wrong count, and for a name that is given twice.
    """
    for table in TABLES:
        given = document.get(table)
        if isinstance(given, dict):
            document[table] = _expanded(given, f"{path} at {table}")


def _expanded(given: dict[str, Any], place: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, spec in given.items():
        if not isinstance(spec, dict) or "count" not in spec:
            found[name] = spec
            continue
        n = spec["count"]
        if not isinstance(n, int) or isinstance(n, bool) or not 1 <= n <= MOST:
            raise ScenarioError(f"found {n!r}; expected 1 to {MOST}", f"{place}.{name}.count")
        common = {key: value for key, value in spec.items() if key != "count"}
        words = {"i": range(1, n + 1)}
        for i, one in enumerate(filled(common, words, n, f"{place}.{name}"), 1):
            if f"{name}{i}" in given:
                raise ScenarioError(
                    f"found {name}{i} and {name} with count = {n}; expected one of them", place
                )
            found[f"{name}{i}"] = one
    return found
