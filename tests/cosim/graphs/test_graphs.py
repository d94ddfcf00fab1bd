"""Graphs: direction of edges, reachability, and the facts of the presets."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.graphs.graph import PRESETS, Graph, union
from cosim.links.markov import closure

ALL = frozenset(range(1, 7))
CHAIN = Graph.of(3, [(2, 1), (3, 2, 0.5)], "chain")  # 1 -> 2 -> 3


def test_an_edge_means_the_first_receives_from_the_second():
    assert CHAIN.edges == ((2, 1), (3, 2))
    assert CHAIN.weights[1, 0] == 1.0 and CHAIN.weights[2, 1] == 0.5
    assert CHAIN.weights.sum() == 1.5
    assert CHAIN.reached(1) == {1, 2, 3} and CHAIN.reached(3) == {3}
    assert CHAIN.roots == {1}


@st.composite
def edge_lists(draw):
    n = draw(st.integers(1, 7))
    pairs = [(i, j) for i in range(1, n + 1) for j in range(1, n + 1) if i != j]
    edges = draw(st.lists(st.sampled_from(pairs), unique=True)) if pairs else []
    return n, edges


@given(edge_lists())
def test_reached_is_what_a_search_finds(graph):
    n, edges = graph
    made = Graph.of(n, edges)
    assert made.edges == tuple(sorted(edges))
    for start in range(1, n + 1):
        known, before = {start}, None
        while known != before:
            before = set(known)
            known |= {i for i, j in edges if j in known}
        assert made.reached(start) == known
        assert (start in made.roots) == (len(known) == n)


@given(edge_lists(), st.randoms())
def test_a_union_has_all_edges_and_at_least_the_roots(graph, random):
    n, edges = graph
    some = [edge for edge in edges if random.random() < 0.5]
    parts = [Graph.of(n, some), Graph.of(n, edges)]
    assert union(parts).edges == parts[1].edges
    assert parts[0].roots <= union(parts).roots


def test_a_union_has_the_greatest_weight():
    assert union([CHAIN, Graph.of(3, [(3, 2, 0.25)])]).weights[2, 1] == 0.5


@pytest.mark.parametrize("name", PRESETS)
def test_no_graph_of_a_preset_is_enough_alone(name):
    assert [graph.name for graph in PRESETS[name]] == ["G1", "G2", "G3"]
    for graph in PRESETS[name]:
        assert graph.n == 6 and not graph.roots
        assert set(np.unique(graph.weights)) == {0.0, 1.0}


def test_the_union_of_ring_is_the_directed_ring():
    ring = union(PRESETS["ring"])
    assert ring.edges == ((1, 6), (2, 1), (3, 2), (4, 3), (5, 4), (6, 5))
    assert ring.roots == ALL


def test_tree3_has_one_root():
    tree = union(PRESETS["tree3"])
    assert tree.roots == {3}
    assert not tree.weights[2].any()  # robot 3 receives from nobody


def test_dense_is_ring_with_chords():
    for ring, dense in zip(PRESETS["ring"], PRESETS["dense"], strict=True):
        assert set(ring.edges) < set(dense.edges) and len(dense.edges) == 3
    assert set(union(PRESETS["dense"]).edges) - set(union(PRESETS["ring"]).edges) == {
        (1, 4), (2, 5), (3, 6),
    }  # fmt: skip
    assert union(PRESETS["dense"]).roots == ALL


@pytest.mark.parametrize(
    "a, b, roots",
    [("ring", (0, 1), set()), ("tree3", (1, 2), set()), ("dense", (0, 1), {4})],
)
def test_two_graphs_together(a, b, roots):
    assert union([PRESETS[a][k] for k in b]).roots == roots


def test_a_graph_does_not_change_behind_its_back():
    weights = np.array([[0.0, 1.0], [0.0, 0.0]])
    graph = Graph(weights)
    weights[:] = 7
    assert graph.edges == ((1, 2),)
    with pytest.raises(ValueError, match="read-only"):
        graph.weights[0, 1] = 2.0


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Graph(np.zeros((2, 3))), r"shape \(2, 3\); expected a square matrix"),
        (lambda: Graph(np.zeros(4)), "expected a square matrix"),
        (lambda: Graph(np.zeros((0, 0))), "expected a square matrix"),
        (lambda: Graph(np.array([[0, -1], [0, 0]])), "w_1,2 = -1; expected 0 or more"),
        (lambda: Graph(np.array([[0, 0], [np.nan, 0]])), "w_2,1 = nan; expected 0 or more"),
        (lambda: Graph(np.eye(2)), "w_1,1 = 1: a robot does not receive from itself"),
        (lambda: Graph.of(3, [(1, 1)]), "w_1,1 = 1: a robot does not"),
        (lambda: Graph.of(3, [(1, 4)]), r"edge \[1, 4\]: robot 4; expected 1 to 3"),
        (lambda: Graph.of(3, [(0, 1)]), r"edge \[0, 1\]: robot 0; expected 1 to 3"),
        (lambda: Graph.of(3, [(1, 2), (1, 2)]), "is listed twice"),
        (lambda: Graph.of(3, [(1, 2, 0)]), "weight 0; expected more than 0"),
        (lambda: Graph.of(3, [(1, 2.5)]), r"edge \[1, 2.5\]; expected \[i, j\] or"),
        (lambda: Graph.of(3, [(1, float("nan"))]), r"expected \[i, j\] or"),
        (lambda: Graph.of(3, [(1,)]), r"expected \[i, j\] or"),
        (lambda: union([]), "graphs of no robots; expected one number"),
        (lambda: union([CHAIN, PRESETS["ring"][0]]), "graphs of 3, 6 robots; expected one number"),
        (lambda: CHAIN.reached(4), "robot 4; expected 1 to 3"),
    ],
)
def test_what_is_no_graph_is_refused(make, message):
    with pytest.raises(ScenarioError, match=message):
        make()


@given(
    n=st.integers(1, 9),
    some=st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), max_size=25, unique=True),
)
def test_roots_and_what_is_reached_are_those_of_the_transitive_closure(n, some):
    edges = [(i, j) for i, j in some if i != j and max(i, j) <= n]
    graph = Graph.of(n, edges)
    flow = closure(graph.weights.T > 0)  # [j - 1, i - 1]: from j to i
    assert graph.edges == tuple(sorted(edges))
    assert graph.roots == {j + 1 for j in range(n) if flow[j].all()}
    for j in range(n):
        assert graph.reached(j + 1) == {i + 1 for i in np.flatnonzero(flow[j])}


def test_a_large_graph_has_no_matrix_in_its_facts():
    n = 20_000
    ring = Graph.of(n, [(i % n + 1, i) for i in range(1, n + 1)])
    assert len(ring.roots) == n and len(union([ring, ring]).edges) == n
    assert ring.facts()["robots"] == n and len(ring.facts()["edges"]) == n
    assert Graph.of(n, [(i + 1, i) for i in range(1, n)]).roots == {1}
