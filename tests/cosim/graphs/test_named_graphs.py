"""Graphs by name and size: their edges, what is random in them, and what cannot be."""

from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.graphs.named import GraphSpec, graph_edges


def edges(kind: str, folder: Path = Path(), **keys: object) -> tuple[int, list[tuple[int, int]]]:
    n, found = graph_edges(msgspec.convert({"kind": kind, **keys}, GraphSpec), folder, "here")
    return n, [tuple(edge) for edge in found.tolist()]


def test_small_graphs_by_hand(tmp_path: Path) -> None:
    assert edges("ring", n=3) == (3, [(1, 3), (2, 1), (3, 2)])
    assert edges("ring", n=3, both=True)[1] == [(1, 2), (1, 3), (2, 1), (2, 3), (3, 1), (3, 2)]
    assert edges("ring", n=1) == (1, [])
    assert edges("tree", n=5) == (5, [(2, 1), (3, 1), (4, 2), (5, 2)])
    assert edges("tree", n=5, branches=4)[1] == [(2, 1), (3, 1), (4, 1), (5, 1)]
    assert edges("complete", n=3)[1] == [(1, 2), (1, 3), (2, 1), (2, 3), (3, 1), (3, 2)]
    #  1 2 3
    #  4 5 6
    n, grid = edges("grid", rows=2, columns=3)
    mutual = {(1, 2), (2, 3), (4, 5), (5, 6), (1, 4), (2, 5), (3, 6)}
    assert n == 6 and set(grid) == mutual | {(j, i) for i, j in mutual}
    (tmp_path / "e.csv").write_text("receiver,sender\n2,1\n4; 2\n\n2,1\n")
    assert edges("file", tmp_path, edges="e.csv") == (4, [(2, 1), (4, 2)])
    assert edges("file", tmp_path, edges="e.csv", n=9, both=True)[0] == 9


@given(n=st.integers(6, 60), seed=st.integers(0, 5), rewire=st.floats(0, 1))
def test_random_graphs_keep_what_they_promise(n: int, seed: int, rewire: float) -> None:
    _, small = edges("small world", n=n, neighbours=4, rewire=rewire, seed=seed)
    assert len(small) == 4 * n  # rewiring moves edges, and makes none
    assert {(j, i) for i, j in small} == set(small) and all(i != j for i, j in small)
    if rewire == 0:
        assert all((i - j) % n in (1, 2, n - 2, n - 1) for i, j in small)
    _, random = edges("random", n=n, degree=3, seed=seed)
    assert Counter(i for i, _ in random) == dict.fromkeys(range(1, n + 1), 3)
    assert len(set(random)) == len(random) and all(i != j for i, j in random)
    _, near = edges("random geometric", n=n, radius=0.3, seed=seed)
    _, nearer = edges("random geometric", n=n, radius=0.2, seed=seed)
    assert {(j, i) for i, j in near} == set(near) and set(nearer) <= set(near)
    assert edges("random", n=n, degree=3, seed=seed)[1] == random  # by the seed alone
    assert edges("random", n=n, degree=3, seed=seed + 1)[1] != random


def test_edges_of_a_small_world_lead_far_away() -> None:
    _, found = edges("small world", n=1000, neighbours=4, rewire=0.1)
    i, j = np.array(found).T
    distance = np.minimum((i - j) % 1000, (j - i) % 1000)
    assert np.mean(distance > 2) == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"kind": "ring"}, "no n; expected the number of robots"),
        ({"kind": "grid", "n": 4}, "a grid has rows and columns, and no n"),
        ({"kind": "ring", "n": 4, "rows": 2}, "found rows or columns of a ring; expected n"),
        ({"kind": "ring", "n": 4, "edges": "x"}, 'expected edges = "FILE" with kind = "file"'),
        ({"kind": "file"}, 'expected edges = "FILE" with kind = "file"'),
        ({"kind": "random", "n": 3, "degree": 3}, "degree 3 of 3 robots; expected less"),
        ({"kind": "small world", "n": 9, "neighbours": 3}, "an even number below"),
        ({"kind": "complete", "n": 10_000}, "99990000 edges; expected at most 10000000"),
        ({"kind": "random", "n": 10**6, "degree": 11}, "11000000 edges; expected at most"),
        ({"kind": "small world", "n": 10**6, "neighbours": 12}, "12000000 edges; expected at"),
        ({"kind": "random geometric", "n": 5000, "radius": 2.0}, "radius 2: more than"),
    ],
)
def test_what_is_no_graph_is_refused(keys: dict[str, object], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        edges(**keys)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "n", "said"),
    [
        ("2,1\n3\n", None, r"e.csv:2: found '3'; expected receiver,sender"),
        ("2,1\n3,x\n", None, r"e.csv:2: found '3,x'"),
        ("2,2\n", None, "robot 2 receives from itself"),
        ("2,7\n", 5, "an edge of robot 7; expected 1 to 5"),
    ],
)
def test_a_wrong_edge_file_is_refused(text: str, n: int | None, said: str, tmp_path: Path) -> None:
    (tmp_path / "e.csv").write_text(text)
    with pytest.raises(ScenarioError, match=said):
        edges("file", tmp_path, edges="e.csv", n=n)
