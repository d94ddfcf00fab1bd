"""A user's graphs in files: weighted adjacency matrices in CSV or TOML.

Row i, column j is w_ij, the weight with which robot i receives from robot j.

CSV: one line a robot, numbers only; an empty line ends a graph and another may follow; ``#``
starts a comment line. Graphs are called like the file, ``NAME`` or ``NAME.1``, ``NAME.2``, …

TOML, with a name for each graph (or G1, G2, …), as a matrix or as a list of edges::

    [[graphs]]
    name = "out"
    weights = [[0, 0, 0], [1, 0, 0], [0, 0.5, 0]]

    [[graphs]]
    robots = 3
    edges = [[1, 3], [3, 1, 0.5]]          # i receives from j, with weight 1 or the one given
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cosim.base import toml
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.files import regular
from cosim.links.graphs import Graph

KEYS = ({"name", "weights"}, {"name", "robots", "edges"})


def read_graphs(path: str | Path) -> tuple[Graph, ...]:
    """The graphs in a file (``.toml``, otherwise CSV), one or more.

    Raises ScenarioError with the file and the line (CSV) or key (TOML) that cannot be.
    """
    path = Path(path)
    try:
        text = regular(path).read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise ScenarioError("no such file; expected weighted graphs", str(path)) from None
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"cannot be read as text ({error})", str(path)) from None
    return _toml(text, path) if path.suffix == ".toml" else _csv(text, path)


def _csv(text: str, path: Path) -> tuple[Graph, ...]:
    blocks: list[tuple[int, list[list[float]]]] = []  # first line and rows of each graph
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#"):
            continue
        if not line.strip():
            inside = False
            continue
        if not inside:
            blocks.append((number, []))
            inside = True
        rows = blocks[-1][1]
        rows.append([_number(cell, f"{path}:{number}") for cell in line.split(",")])
        if len(rows[-1]) != len(rows[0]):
            raise ScenarioError(
                f"{len(rows[-1])} values; expected {len(rows[0])} as in the line before",
                f"{path}:{number}",
            )
    if not blocks:
        raise ScenarioError("no graph; expected lines of numbers, one per robot", str(path))
    names = (
        [path.stem] if len(blocks) == 1 else [f"{path.stem}.{k + 1}" for k in range(len(blocks))]
    )
    return tuple(
        _matrix(rows, name, f"{path}:{number}")
        for name, (number, rows) in zip(names, blocks, strict=True)
    )


def _number(cell: str, place: str) -> float:
    try:
        return float(cell)
    except ValueError:
        raise ScenarioError(f"{cell.strip()!r} is not a number", place) from None


def _matrix(rows: list[list[float]], name: str, place: str) -> Graph:
    if len(rows) != len(rows[0]):
        raise ScenarioError(
            f"{len(rows)} lines of {len(rows[0])} values; expected a square matrix", place
        )
    try:
        return Graph(np.array(rows), name)
    except CosimError as error:
        raise ScenarioError(str(error), place) from None


def _toml(text: str, path: Path) -> tuple[Graph, ...]:
    document = toml.parse(text, str(path))
    tables = document.pop("graphs", None)
    if document or not isinstance(tables, list) or not tables:
        found = ", ".join(document) or f"graphs = {tables!r}"
        raise ScenarioError(f"{found}; expected [[graphs]] tables and nothing else", str(path))
    return tuple(_table(table, k, f"{path} at graphs[{k}]") for k, table in enumerate(tables))


def _table(table: Any, k: int, place: str) -> Graph:
    keys = set(table) if isinstance(table, dict) else set()
    if not any({"name"} | keys == known for known in KEYS):
        raise ScenarioError(
            f"keys {', '.join(sorted(keys)) or 'none'}; expected weights, or robots and edges"
            " (and name)",
            place,
        )
    name = table.get("name", f"G{k + 1}")
    if not isinstance(name, str):
        raise ScenarioError(f"name = {name!r}; expected a text", place)
    if "weights" in table:
        return _matrix(_rows(table["weights"], place), name, f"{place}.weights")
    robots, edges = table["robots"], table["edges"]
    if type(robots) is not int or robots < 1:
        raise ScenarioError(f"robots = {robots!r}; expected the number of robots", place)
    if not isinstance(edges, list) or not all(isinstance(edge, list) for edge in edges):
        raise ScenarioError(f"edges = {edges!r}; expected a list of [i, j] or [i, j, w]", place)
    try:
        return Graph.of(robots, edges, name)
    except CosimError as error:
        raise ScenarioError(str(error), f"{place}.edges") from None


def _rows(weights: Any, place: str) -> list[list[float]]:
    rows: list[list[float]] = []
    for i, row in enumerate(weights if isinstance(weights, list) else [weights]):
        if not isinstance(row, list) or not all(type(w) in (int, float) for w in row):
            raise ScenarioError(f"{row!r}; expected a list of numbers", f"{place}.weights[{i}]")
        if len(row) != len(weights):
            raise ScenarioError(
                f"{len(row)} values; expected {len(weights)}, as many as rows",
                f"{place}.weights[{i}]",
            )
        rows.append([float(w) for w in row])
    if not rows:
        raise ScenarioError("no rows; expected one per robot", f"{place}.weights")
    return rows
