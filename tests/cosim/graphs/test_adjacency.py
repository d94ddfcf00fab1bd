"""Graphs in files, and the line or key that is wrong in one."""

from __future__ import annotations

import pytest

from cosim.base.errors import ScenarioError
from cosim.graphs.named import read_graphs


def read(tmp_path, text, name="net.csv"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return read_graphs(tmp_path / name)


def test_a_line_is_what_one_robot_receives(tmp_path):
    (graph,) = read(tmp_path, "# from 1, 2, 3\n0, 0, 0\n1, 0, 0\n# robot 3\n0, 0.5, 0\n")
    assert graph.name == "net"
    assert graph.edges == ((2, 1), (3, 2))
    assert graph.weights[2, 1] == 0.5
    assert graph.roots == {1}


def test_an_empty_line_begins_another_graph(tmp_path):
    a, b = read(tmp_path, "\n0,1\n0,0\n\n  \n0,0\n2,0\n\n")
    assert (a.name, b.name) == ("net.1", "net.2")
    assert (a.edges, b.edges) == (((1, 2),), ((2, 1),))


def test_toml_has_matrices_and_edges(tmp_path):
    text = """
    [[graphs]]
    name = "out"
    weights = [[0, 0, 0], [1, 0, 0], [0, 0.5, 0]]
    [[graphs]]
    robots = 3
    edges = [[1, 3], [3, 1, 0.5]]
    """
    out, second = read(tmp_path, text, "net.toml")
    assert (out.name, second.name) == ("out", "G2")
    assert out.edges == ((2, 1), (3, 2))
    assert second.edges == ((1, 3), (3, 1)) and second.weights[2, 0] == 0.5


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "net.csv: no graph; expected lines of numbers"),
        ("# nothing\n\n", "net.csv: no graph"),
        ("0,1\n0,x\n", "net.csv:2: 'x' is not a number"),
        ("0;1\n0;0\n", "net.csv:1: '0;1' is not a number"),
        ("0,1\n\n0,0\n0,0\n", "net.csv:1: 1 lines of 2 values; expected a square matrix"),
        ("0,1\n0,0,0\n", "net.csv:2: 3 values; expected 2 as in the line before"),
        ("0,1\n0,0\n\n0,0\n-1,0\n", "net.csv:4: w_2,1 = -1; expected 0 or more"),
        ("0,1\n0,0\n\n1,0\n0,0\n", "net.csv:4: w_1,1 = 1: a robot does not receive from itself"),
        ("0,nan\n0,0\n", "net.csv:1: w_1,2 = nan"),
    ],
)
def test_a_csv_error_has_its_line(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message):
        read(tmp_path, text)


@pytest.mark.parametrize(
    "text, message",
    [
        ("graphs = [", "net.toml: not valid TOML"),
        ("", "net.toml: graphs = None; expected .* tables and nothing else"),
        ("graphs = []", r"graphs = \[\]; expected"),
        ("graph = 1", "net.toml: graph; expected"),
        ("[[graphs]]\nweights = [[0]]\n[x]\n", "net.toml: x; expected"),
        ("[[graphs]]\n", r"net.toml at graphs\[0\]: keys none; expected weights, or robots"),
        ("graphs = [1]", r"at graphs\[0\]: keys none"),
        ("[[graphs]]\nrobots = 2\n", r"at graphs\[0\]: keys robots; expected weights, or"),
        ("[[graphs]]\nweights = [[0]]\nedges = []\n", r"at graphs\[0\]: keys edges, weights"),
        ("[[graphs]]\nname = 1\nweights = [[0]]\n", "name = 1; expected a text"),
        ("[[graphs]]\nweights = 1\n", r"at graphs\[0\].weights\[0\]: 1; expected a list"),
        ("[[graphs]]\nweights = []\n", r"at graphs\[0\].weights: no rows"),
        ("[[graphs]]\nweights = [[0, 1], [true, 0]]\n", r"weights\[1\]: \[True, 0\]; expected"),
        ("[[graphs]]\nweights = [[0, 1], [0]]\n", r"weights\[1\]: 1 values; expected 2"),
        ("[[graphs]]\nweights = [[0, -1], [0, 0]]\n", r"at graphs\[0\].weights: w_1,2 = -1"),
        ("[[graphs]]\nrobots = 0\nedges = []\n", "robots = 0; expected the number of robots"),
        ("[[graphs]]\nrobots = 2\nedges = [1]\n", r"edges = \[1\]; expected a list of"),
        (
            "[[graphs]]\nrobots = 2\nedges = [[1, 3]]\n",
            r"graphs\[0\].edges: edge \[1, 3\]: robot 3",
        ),
        ('[[graphs]]\nrobots = 2\nedges = [["a", 1]]\n', r"edges: edge \['a', 1\]; expected"),
    ],
)
def test_a_toml_error_has_its_key(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message):
        read(tmp_path, text, "net.toml")


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ScenarioError, match=r"none.csv: no such file; expected weighted graphs"):
        read_graphs(tmp_path / "none.csv")
    (tmp_path / "x.csv").write_bytes(b"\xff\xfe0\x00")
    with pytest.raises(ScenarioError, match=r"x.csv: cannot be read as text"):
        read_graphs(tmp_path / "x.csv")
