"""Interaction graphs: weighted directed edges between robots, and three presets of six robots.

An edge (i, j) means that robot i receives from robot j; robots are numbered from 1. Information
flows from j to i, which the presets write as "i←j". A root is a robot whose information reaches all
others; if there is one, a directed spanning tree exists.

Source: the paper, Sec. V, for the definitions; the presets are our own construction.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.laws import FloatArray
from cosim.links.reachability import BoolArray, closure


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """A weighted directed graph of n robots.

    `weights` (n, n): w_ij in row i - 1, column j - 1 is more than 0 where robot i receives from
    robot j, and 0 where it does not; w_ii = 0. Pure numbers: the factor in 1/s is a gain of the
    controller. `name` is what the graph is called in schedules.
    """

    weights: FloatArray
    name: str = ""

    def __post_init__(self) -> None:
        """Take a private copy; refuse what is no graph. Raises ScenarioError with the entry."""
        weights = np.array(self.weights, dtype=np.float64)
        weights.flags.writeable = False
        object.__setattr__(self, "weights", weights)
        if weights.ndim != 2 or weights.shape[0] != weights.shape[1] or not weights.size:
            raise ScenarioError(f"weights of shape {weights.shape}; expected a square matrix")
        wrong = np.argwhere(~(np.isfinite(weights) & (weights >= 0)))
        if wrong.size:
            i, j = wrong[0].tolist()
            raise ScenarioError(f"{_entry(weights, i, j)}; expected 0 or more")
        loops = np.flatnonzero(np.diagonal(weights))
        if loops.size:
            i = int(loops[0])
            raise ScenarioError(
                f"{_entry(weights, i, i)}: a robot does not receive from itself; expected 0"
            )

    @staticmethod
    def of(n: int, edges: Iterable[Sequence[float]], name: str = "") -> Graph:
        """The graph of `n` robots with edges (i, j) of weight 1, or (i, j, w).

        Raises ScenarioError for an edge that cannot be, or is given twice.
        """
        weights = np.zeros((n, n))
        for edge in edges:
            i, j, w = _edge(edge, n)
            if weights[i - 1, j - 1]:
                raise ScenarioError(f"edge {list(edge)} is listed twice")
            weights[i - 1, j - 1] = w
        return Graph(weights, name)

    @property
    def n(self) -> int:
        """Number of robots."""
        return int(self.weights.shape[0])

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """All (i, j) where i receives from j, in order."""
        return tuple((i + 1, j + 1) for i, j in np.argwhere(self.weights > 0).tolist())

    def reached(self, robot: int) -> frozenset[int]:
        """The robots that information of `robot` reaches, itself included. Raises ScenarioError."""
        check_robot(robot, self.n)
        return _numbers(self._flow()[robot - 1])

    @property
    def roots(self) -> frozenset[int]:
        """The robots whose information reaches all others; none without a spanning tree."""
        return _numbers(np.asarray(self._flow().all(axis=1)))

    def _flow(self) -> BoolArray:
        """(n, n): whether the information of robot j reaches robot i, at [j - 1, i - 1]."""
        return closure(self.weights.T > 0)

    def facts(self) -> dict[str, Any]:
        """Name and weights, row i: what robot i + 1 receives."""
        return {"name": self.name, "weights": self.weights.tolist()}


def union(graphs: Sequence[Graph]) -> Graph:
    """The graph with the edges of all, each with its greatest weight. Raises ScenarioError."""
    sizes = {graph.n for graph in graphs}
    if len(sizes) != 1:
        raise ScenarioError(
            f"graphs of {', '.join(map(str, sorted(sizes))) or 'no'} robots; expected one number"
        )
    return Graph(np.max([graph.weights for graph in graphs], axis=0), "union")


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


def _numbers(chosen: BoolArray) -> frozenset[int]:
    return frozenset((np.flatnonzero(chosen) + 1).tolist())


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
