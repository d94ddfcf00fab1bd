"""Interaction graphs: weighted directed edges between robots, and three presets of six robots.

An edge (i, j) means that robot i receives from robot j; robots are numbered from 1. Information
flows from j to i, which the presets write as "i←j". A root is a robot whose information reaches all
others; if there is one, a directed spanning tree exists.

Source: the paper, Sec. V, for the definitions; the presets are our own construction.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from cosim.base.errors import ScenarioError
from cosim.links.laws import FloatArray

#: Robots up to which a graph is written down as a matrix; larger ones as a list of edges.
MATRIX = 24


@final
class Graph:
    """A weighted directed graph of n robots.

    `weights` (n, n): w_ij in row i - 1, column j - 1 is more than 0 where robot i receives from
    robot j, and 0 where it does not; w_ii = 0. Pure numbers: the factor in 1/s is a gain of the
    controller. `name` is what the graph is called in schedules. Raises ScenarioError for what is no
    graph, with the entry.
    """

    __slots__ = ("_known", "n", "name")

    def __init__(self, weights: ArrayLike, name: str = "") -> None:
        given = np.asarray(weights, dtype=np.float64)
        if given.ndim != 2 or given.shape[0] != given.shape[1] or not given.size:
            raise ScenarioError(f"weights of shape {given.shape}; expected a square matrix")
        wrong = np.argwhere(~(np.isfinite(given) & (given >= 0)))
        if wrong.size:
            i, j = wrong[0].tolist()
            raise ScenarioError(f"{_entry(given, i, j)}; expected 0 or more")
        loops = np.flatnonzero(np.diagonal(given))
        if loops.size:
            i = int(loops[0])
            raise ScenarioError(
                f"{_entry(given, i, i)}: a robot does not receive from itself; expected 0"
            )
        self.n, self.name = len(given), name
        found = np.argwhere(given > 0).tolist()
        self._known = {(i + 1, j + 1): float(given[i, j]) for i, j in found}

    @staticmethod
    def of(n: int, edges: Iterable[Sequence[float]], name: str = "") -> Graph:
        """The graph of `n` robots with edges (i, j) of weight 1, or (i, j, w).

        Raises ScenarioError for an edge that cannot be, or is given twice.
        """
        known: dict[tuple[int, int], float] = {}
        for edge in edges:
            i, j, w = _edge(edge, n)
            if (i, j) in known:
                raise ScenarioError(f"edge {list(edge)} is listed twice")
            if i == j:
                raise ScenarioError(
                    f"w_{i},{i} = {w:g}: a robot does not receive from itself; expected 0"
                )
            known[i, j] = w
        return _graph(n, known, name)

    @property
    def weights(self) -> FloatArray:
        """The matrix (n, n), a copy, for graphs that are not too large for one."""
        weights = np.zeros((self.n, self.n))
        for (i, j), w in self._known.items():
            weights[i - 1, j - 1] = w
        weights.flags.writeable = False
        return weights

    def weight(self, i: int, j: int) -> float:
        """w_ij, 0 where robot i does not receive from robot j."""
        return self._known.get((i, j), 0.0)

    @property
    def weighted(self) -> Mapping[tuple[int, int], float]:
        """The weight of each edge (i, j), in order."""
        return self._known

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """All (i, j) where i receives from j, in order."""
        return tuple(self._known)

    def reached(self, robot: int) -> frozenset[int]:
        """The robots that information of `robot` reaches, itself included. Raises ScenarioError."""
        check_robot(robot, self.n)
        return reachable(robot, self._towards(receivers=True))

    @property
    def roots(self) -> frozenset[int]:
        """The robots whose information reaches all others; none without a spanning tree.

        Of the robots from which a search of what is not reached yet has begun, the last one is a
        root, if there is any; the roots are then those whose information reaches it.
        """
        forwards, seen, last = self._towards(receivers=True), set[int](), 0
        for robot in range(1, self.n + 1):
            if robot not in seen:
                seen |= reachable(robot, forwards, seen)
                last = robot
        if len(reachable(last, forwards)) < self.n:
            return frozenset()
        return reachable(last, self._towards(receivers=False))

    def _towards(self, *, receivers: bool) -> Mapping[int, list[int]]:
        """The receivers of each robot, or those it receives from."""
        found: defaultdict[int, list[int]] = defaultdict(list)
        for i, j in self._known:
            found[j if receivers else i].append(i if receivers else j)
        return found

    def facts(self) -> dict[str, Any]:
        """Name and weights, row i: what robot i + 1 receives; of many robots, the edges."""
        if self.n <= MATRIX:
            return {"name": self.name, "weights": self.weights.tolist()}
        edges = [[i, j, w] for (i, j), w in self._known.items()]
        return {"name": self.name, "robots": self.n, "edges": edges}


def _graph(n: int, known: Mapping[tuple[int, int], float], name: str) -> Graph:
    """A graph of edges that have been checked, by their weights."""
    graph = object.__new__(Graph)
    graph.n, graph.name, graph._known = n, name, dict(sorted(known.items()))
    return graph


def union(graphs: Sequence[Graph]) -> Graph:
    """The graph with the edges of all, each with its greatest weight. Raises ScenarioError."""
    sizes = {graph.n for graph in graphs}
    if len(sizes) != 1:
        raise ScenarioError(
            f"graphs of {', '.join(map(str, sorted(sizes))) or 'no'} robots; expected one number"
        )
    known: dict[tuple[int, int], float] = {}
    for graph in graphs:
        for edge, w in graph.weighted.items():
            known[edge] = max(w, known.get(edge, 0.0))
    return _graph(sizes.pop(), known, "union")


def check_robot(robot: int, n: int) -> None:
    """Refuse a number that no robot has. Raises ScenarioError."""
    if not 1 <= robot <= n:
        raise ScenarioError(f"robot {robot}; expected 1 to {n}")


def _edge(edge: Sequence[float], n: int) -> tuple[int, int, float]:
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) for x in edge)
    if not numbers or len(edge) not in (2, 3) or not all(float(x).is_integer() for x in edge[:2]):
        raise ScenarioError(f"edge {list(edge)}; expected [i, j] or [i, j, weight]")
    i, j = int(edge[0]), int(edge[1])
    for robot in (i, j):
        if not 1 <= robot <= n:
            raise ScenarioError(f"edge {list(edge)}: robot {robot}; expected 1 to {n}")
    w = float(edge[2]) if len(edge) == 3 else 1.0
    if not w > 0:
        raise ScenarioError(f"edge {list(edge)}: weight {w:g}; expected more than 0")
    return i, j, w


def _entry(weights: FloatArray, i: int, j: int) -> str:
    return f"w_{i + 1},{j + 1} = {weights[i, j]:g}"


def _edge_triple(*edges: tuple[tuple[int, int], ...]) -> tuple[Graph, ...]:
    return tuple(Graph.of(6, graph, f"G{k}") for k, graph in enumerate(edges, 1))


#: Three graphs of six robots each, all weights 1, for the paper's Sec. VII-B: its Fig. 4 is lost.
#:
#: `ring`: two edges at a time; the union is the directed ring 1→2→…→6→1, every robot is a root.
#: `tree3`: two edges at a time; all information in the union comes from robot 3, the only root.
#: `dense`: the two edges of `ring` and a chord across it at a time, 1←4, 2←5, 3←6; every robot is
#: a root of the union, and agreement comes sooner than on `ring`.
#:
#: No graph alone has a spanning tree; nor have two together, except in `dense` (root 4, 5 or 6).
PRESETS: Mapping[str, tuple[Graph, ...]] = {
    "ring": _edge_triple(((2, 1), (5, 4)), ((3, 2), (6, 5)), ((4, 3), (1, 6))),
    "tree3": _edge_triple(((1, 3), (2, 1)), ((4, 3), (5, 4)), ((6, 5), (2, 3))),
    "dense": _edge_triple(
        ((2, 1), (5, 4), (1, 4)), ((3, 2), (6, 5), (2, 5)), ((4, 3), (1, 6), (3, 6))
    ),
}


def reachable(
    start: int, following: Mapping[int, Sequence[int]], beyond: Set[int] = frozenset()
) -> frozenset[int]:
    """All that paths lead to from `start`, itself included, but nothing that is `beyond`.

    `following`: where one step leads from each; the time grows with these.
    """
    found, waiting = {start}, [start]
    while waiting:
        for other in following.get(waiting.pop(), ()):
            if other not in found and other not in beyond:
                found.add(other)
                waiting.append(other)
    return frozenset(found)
