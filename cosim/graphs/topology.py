"""Topology: the weights of the edges between robots over time, as the receivers read them.

Graphs and their switching give a stream of rows for every receiver: the weight of each of its
senders' edges at its steps, 0 if the edge is not present. As with a link's table, the sizes of the
chunks do not matter, and all values depend on (seed, name) only: all receivers see the same graph
at the same time, whatever their periods.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cosim.base.convert import Number
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.base.random_numbers import generator
from cosim.graphs.graph import PRESETS, Graph, check_robot, union
from cosim.graphs.named import read_graphs
from cosim.graphs.switching import Choices, Random, Schedule, Static, Switching
from cosim.links.keys import si
from cosim.links.laws import FloatArray
from cosim.links.semantics import Grid
from cosim.links.table import INDEX_MAXIMUM


@dataclass(frozen=True, slots=True)
class Topology:
    """Graphs of n robots and how they switch; `seed` and `name` decide on what is random.

    Facts are about the graphs that recur (see :meth:`Switching.recurrent`), as the theorems
    ask about. Raises ScenarioError for graphs of different size, or that do not suit the switching.
    """

    graphs: tuple[Graph, ...]
    switching: Switching
    seed: int
    name: str = "topology"
    _union: list[Graph] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check that everything fits. Raises ScenarioError."""
        if self.seed < 0:
            raise ScenarioError(f"seed {self.seed}; expected 0 or more")
        union(self.graphs)
        self.switching.check(len(self.graphs))

    @property
    def n(self) -> int:
        """Number of robots."""
        return self.graphs[0].n

    @property
    def edges(self) -> tuple[tuple[int, int], ...]:
        """All (i, j) of all graphs, i receives from j: the links a scenario needs."""
        return union(self.graphs).edges

    @property
    def union(self) -> Graph:
        """The union of the graphs that last."""
        if not self._union:
            lasting = self.switching.recurrent(len(self.graphs))
            self._union.append(union([self.graphs[k] for k in lasting]))
        return self._union[0]

    @property
    def roots(self) -> frozenset[int]:
        """The robots whose information reaches all others recurrently: the roots of the union."""
        return self.union.roots

    @property
    def has_joint_spanning_tree(self) -> bool:
        """True if the graphs that last have a spanning tree together (Theorems 3 and 4)."""
        return bool(self.roots)

    def weights(
        self,
        receiver: int,
        senders: Sequence[int],
        *,
        period: int,
        h: float,
        length: int | None = None,
    ) -> WeightStream:
        """The weights w_ij of `receiver` i for each j of `senders`, at its hits.

        `period`: ticks of `h` (s) between two hits; `length`: how many there are. A sender may be
        given that has no edge: its weight is 0. Raises ScenarioError for numbers no robot has.
        """
        for robot in (receiver, *senders):
            check_robot(robot, self.n)
        looking = Grid(1, period, h).receiving_period
        choices = self.switching.stream(len(self.graphs), looking, generator(self.seed, self.name))
        table = np.array([[g.weight(receiver, j) for j in senders] for g in self.graphs])
        return WeightStream(choices, table, length)

    def mean_weight(self, receiver: int, sender: int, *, period: int, h: float) -> float:
        """Long-run mean of w_ij at the hits of `receiver` i, `period` ticks of `h` (s) apart.

        Of the mean graph, whatever the seed draws. Raises ScenarioError for numbers no robot has.
        """
        for robot in (receiver, sender):
            check_robot(robot, self.n)
        shares = self.switching.shares(len(self.graphs), Grid(1, period, h).receiving_period)
        weights = [graph.weight(receiver, sender) for graph in self.graphs]
        return float(shares @ np.array(weights))

    def facts(self) -> dict[str, Any]:
        """Name, graphs, switching, seed."""
        return {"graphs": [graph.facts() for graph in self.graphs], **self.switching_facts()}

    def switching_facts(self) -> dict[str, Any]:
        """Name, switching, seed, but not the graphs, which are in the scenario."""
        return {
            "name": self.name,
            **self.switching.facts(),
            "seed": self.seed,
        }


class WeightStream:
    """Rows in order, in chunks whose sizes do not change them; what a table source writes."""

    def __init__(self, choices: Choices, table: FloatArray, length: int | None = None) -> None:
        self._choices, self._table = choices, table  # table (graphs, senders)
        self._length = INDEX_MAXIMUM if length is None else length
        self._row = 0

    @property
    def row(self) -> int:
        """The next row."""
        return self._row

    def rows(self, n: int) -> FloatArray:
        """Return the next `n` rows, (n, senders): the dimensionless weight of each edge, 0: none.

        Raises RunError beyond the length the stream was opened for.
        """
        if self._row + n > self._length:
            raise RunError(
                f"rows {self._row} to {self._row + n} of edge weights opened for {self._length}"
            )
        self._row += n
        rows: FloatArray = self._table[self._choices.take(n)]
        return rows


def make_topology(
    *,
    graphs: str | Sequence[str | Sequence[tuple[int, int]]],
    dwell: Number | None = None,
    schedule: Sequence[tuple[Number, str]] | None = None,
    repeat: Number | None = None,
    seed: int,
    folder: Path,
    name: str = "topology",
    place: str = "",
) -> Topology:
    """A topology from its entries in a scenario.

    `graphs`: a preset, or files of graphs relative to `folder`, or edges [receiver, sender] of each
    graph, which are called G1, G2, ...; `dwell`: random switching;
    `schedule`: (time, name of a graph) in order, repeated every `repeat`; neither: one graph,
    static. Raises ScenarioError that starts with `place`.
    """
    try:
        found = _graphs(graphs, folder)
        if dwell is not None and (schedule is not None or repeat is not None):
            raise ScenarioError("dwell means random switching; expected no schedule and no repeat")
        if schedule is None and repeat is not None:
            raise ScenarioError("repeat without a schedule; expected schedule = [[time, graph], …]")
        switching: Switching = Static()
        if dwell is not None:
            switching = Random(si(dwell, "dwell"))
        elif schedule is not None:
            switching = _schedule(schedule, repeat, [graph.name for graph in found])
        return Topology(found, switching, seed, name)
    except CosimError as error:
        raise ScenarioError(str(error), place) from None


def _graphs(
    graphs: str | Sequence[str | Sequence[tuple[int, int]]], folder: Path
) -> tuple[Graph, ...]:
    names = [graphs] if isinstance(graphs, str) else list(graphs)
    if len(names) == 1 and names[0] in PRESETS:
        return PRESETS[str(names[0])]
    n = max((robot for g in names if not isinstance(g, str) for e in g for robot in e), default=0)
    found: list[Graph] = []
    for k, name in enumerate(names, 1):
        if not isinstance(name, str):
            found.append(Graph.of(n, name, f"G{k}"))
            continue
        if Path(name).suffix not in (".csv", ".toml"):
            raise ScenarioError(
                f"graphs = {name!r}; expected one of {', '.join(PRESETS)}, or .csv or .toml files"
            )
        found.extend(read_graphs(folder / name))
    return tuple(found)


def _schedule(
    schedule: Sequence[tuple[Number, str]], repeat: Number | None, names: list[str]
) -> Schedule:
    times, indices = [], []
    for k, (time, graph) in enumerate(schedule):
        if names.count(graph) != 1:
            problem = "there is none" if graph not in names else "there is more than one"
            raise ScenarioError(f"schedule[{k}]: graph {graph!r}, {problem} among {names}")
        times.append(si(time, f"schedule[{k}]"))
        indices.append(names.index(graph))
    return Schedule(tuple(times), tuple(indices), None if repeat is None else si(repeat, "repeat"))
