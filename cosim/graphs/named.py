"""Graphs of any size by name (ring, grid, tree, small world, random, random geometric), or files.

An edge (i, j) means that robot i receives from robot j; robots are numbered from 1, as in
:mod:`cosim.graphs.graph`. Random graphs depend on their seed and parameters only.

A file has a list of edges, or weighted adjacency matrices: row i, column j is w_ij, the weight with
which robot i receives from robot j. CSV: one line a robot, numbers only; an empty line ends a graph
and another may follow; ``#`` starts a comment line. Graphs are called like the file, ``NAME`` or
``NAME.1``, ``NAME.2``, … TOML, with a name for each graph (or G1, G2, …), as a matrix or edges::

    [[graphs]]
    name = "out"
    weights = [[0, 0, 0], [1, 0, 0], [0, 0.5, 0]]

    [[graphs]]
    robots = 3
    edges = [[1, 3], [3, 1, 0.5]]          # i receives from j, with weight 1 or the one given
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from cosim.base import toml
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.files import regular
from cosim.base.random_numbers import generator
from cosim.graphs.graph import Graph

#: Most robots and most edges of a graph.
MOST_ROBOTS, MOST_EDGES = 1_000_000, 10_000_000
Edges = NDArray[np.int64]
Count = Annotated[int, msgspec.Meta(ge=1, le=MOST_ROBOTS)]


class GraphSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A graph of a scenario, ``[graphs.NAME]``.

    `n`: robots; of a grid `rows` times `columns` instead. `both`: robots receive from each other,
    in place of one from the other (grid, small world, and random geometric always are so).

    ring: i receives from i - 1. tree: from the parent, `branches` children each. complete: from
    all. small world: from `neighbours` on the ring, each edge moved to a random robot with the
    probability `rewire` (Watts, Strogatz 1998). random: each from `degree` others. random
    geometric: from those nearer than `radius` in the unit square. file: of `edges`, lines
    ``receiver,sender``.
    """

    kind: Literal[
        "ring", "grid", "tree", "complete", "small world", "random", "random geometric", "file"
    ]
    n: Count | None = None
    rows: Count | None = None
    columns: Count | None = None
    branches: Count = 2
    neighbours: Annotated[int, msgspec.Meta(ge=2)] = 4
    rewire: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.1
    degree: Count = 2
    radius: Annotated[float, msgspec.Meta(gt=0)] = 0.1
    edges: str = ""
    both: bool = False
    seed: Annotated[int, msgspec.Meta(ge=0)] = 0


def graph_edges(spec: GraphSpec, folder: Path, place: str) -> tuple[int, Edges]:
    """(number of robots, edges (m, 2): receiver and sender, in order, each once).

    `folder`: that of an edge file. Raises ScenarioError at `place` for a graph that cannot be.
    """
    n = _robots(spec, place)
    if spec.kind == "file":
        edges = _read(folder / spec.edges, place)
        n = n or (int(edges.max()) if edges.size else 0)
    else:
        edges = _made(spec, n, place)
    if spec.both and edges.size:
        edges = np.concatenate([edges, edges[:, ::-1]])
    if edges.size and (edges.min() < 1 or edges.max() > n):
        raise ScenarioError(f"an edge of robot {edges.max()}; expected 1 to {n}", place)
    if (edges[:, 0] == edges[:, 1]).any():
        robot = edges[edges[:, 0] == edges[:, 1]][0, 0]
        raise ScenarioError(f"robot {robot} receives from itself; expected another", place)
    return n, np.unique(edges, axis=0)


def _robots(spec: GraphSpec, place: str) -> int:
    if spec.kind == "grid":
        if spec.rows is None or spec.columns is None or spec.n is not None:
            raise ScenarioError("a grid has rows and columns, and no n", place)
        return spec.rows * spec.columns
    if spec.rows is not None or spec.columns is not None:
        raise ScenarioError(f"found rows or columns of a {spec.kind}; expected n", place)
    if (spec.edges != "") != (spec.kind == "file"):
        raise ScenarioError('expected edges = "FILE" with kind = "file", and only there', place)
    if spec.n is None and spec.kind != "file":
        raise ScenarioError("no n; expected the number of robots", place)
    return spec.n or 0


def _made(spec: GraphSpec, n: int, place: str) -> Edges:
    robots = np.arange(1, n + 1, dtype=np.int64)
    if spec.kind == "ring":
        return _pairs(robots, np.roll(robots, 1)) if n > 1 else _pairs(robots[1:], robots[1:])
    if spec.kind == "grid":
        return _grid(robots.reshape(spec.rows or 1, spec.columns or 1))
    if spec.kind == "tree":
        return _pairs(robots[1:], (robots[1:] - 2) // spec.branches + 1)
    expected = {"complete": n * (n - 1), "random": n * spec.degree,
                "small world": n * spec.neighbours}.get(spec.kind, 0)  # fmt: skip
    if expected > MOST_EDGES:
        raise ScenarioError(f"{expected} edges; expected at most {MOST_EDGES}", place)
    if spec.kind == "complete":
        receivers, senders = np.divmod(np.arange(n * n, dtype=np.int64), max(n, 1))
        return _pairs(*(x[receivers != senders] + 1 for x in (receivers, senders)))
    rng = generator(spec.seed, f"graph {spec.kind}")
    if spec.kind == "random":
        if spec.degree >= n:
            raise ScenarioError(f"degree {spec.degree} of {n} robots; expected less", place)
        senders = np.array([_others(rng, n, i, spec.degree) for i in range(n)]).reshape(-1)
        return _pairs(np.repeat(robots, spec.degree), senders + 1)
    if spec.kind == "small world":
        return _small_world(rng, n, spec, place)
    return _near(rng.random((n, 2)), spec.radius, place)


def _pairs(receivers: Edges, senders: Edges) -> Edges:
    return np.column_stack([receivers, senders]).astype(np.int64)


def _mutual(edges: Edges) -> Edges:
    return np.concatenate([edges, edges[:, ::-1]])


def _grid(robots: Edges) -> Edges:
    along = _pairs(robots[:, 1:].ravel(), robots[:, :-1].ravel())
    down = _pairs(robots[1:].ravel(), robots[:-1].ravel())
    return _mutual(np.concatenate([along, down]))


def _others(rng: np.random.Generator, n: int, i: int, degree: int) -> Edges:
    """`degree` different robots other than `i`, from 0."""
    drawn: set[int] = set()
    while len(drawn) < degree:
        drawn.add(int(rng.integers(n - 1)))
    return np.array([k + (k >= i) for k in sorted(drawn)], dtype=np.int64)


def _small_world(rng: np.random.Generator, n: int, spec: GraphSpec, place: str) -> Edges:
    if spec.neighbours % 2 or spec.neighbours >= n:
        raise ScenarioError(
            f"{spec.neighbours} neighbours of {n} robots; expected an even number below", place
        )
    around: list[set[int]] = [set() for _ in range(n)]
    for step in range(1, spec.neighbours // 2 + 1):
        for i in range(n):
            around[i].add((i + step) % n)
            around[(i + step) % n].add(i)
    for step in range(1, spec.neighbours // 2 + 1):
        moved = rng.random(n) < spec.rewire
        for i in np.flatnonzero(moved).tolist():
            old = (i + step) % n
            if old not in around[i] or len(around[i]) >= n - 1:
                continue
            while (new := int(rng.integers(n))) == i or new in around[i]:
                pass
            around[i] = (around[i] - {old}) | {new}
            around[old].remove(i)
            around[new].add(i)
    found = [(i + 1, j + 1) for i in range(n) for j in sorted(around[i])]
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _near(places: NDArray[np.float64], radius: float, place: str) -> Edges:
    from scipy.spatial import cKDTree

    tree = cKDTree(places)
    if tree.count_neighbors(tree, radius) > MOST_EDGES:
        raise ScenarioError(f"radius {radius:g}: more than {MOST_EDGES} edges", place)
    pairs = tree.query_pairs(radius, output_type="ndarray")
    return _mutual(np.asarray(pairs, dtype=np.int64) + 1)


def _read(path: Path, place: str) -> Edges:
    """The edges in a file of lines ``receiver,sender``; the first may be a heading."""
    found = list(_lines(toml.read_text(path, "a file of edges (.csv)"), path, place))
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _lines(text: str, path: Path, place: str) -> Iterator[tuple[int, int]]:
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip() for cell in line.replace(";", ",").split(",")]
        if not line.strip() or (number == 1 and not cells[0].isdigit()):
            continue
        if len(cells) != 2 or not all(cell.isdigit() for cell in cells):
            raise ScenarioError(
                f"{path}:{number}: found {line.strip()!r}; expected receiver,sender", place
            )
        yield int(cells[0]), int(cells[1])


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
