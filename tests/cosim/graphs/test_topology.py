"""Switching graphs, the weights that every receiver reads, and the roots."""

from __future__ import annotations

from fractions import Fraction
from math import gcd

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.base.random_numbers import generator
from cosim.graphs.graph import PRESETS, Graph
from cosim.graphs.switching import Random, Schedule, Static, Switching
from cosim.graphs.topology import Topology, make_topology
from cosim.links.laws import decimal_fraction

ALL = frozenset(range(1, 7))
CHAIN = Graph.of(3, [(2, 1), (3, 2, 0.5)], "chain")  # 1 -> 2 -> 3
BACK = Graph.of(3, [(1, 3)], "back")
NONE = Graph.of(3, [], "none")


def rows(topology, receiver=1, senders=(3,), n=100, period=1, h=0.005):
    return topology.weights(receiver, senders, period=period, h=h).rows(n)


# switching

SWITCHES = [
    Random(0.15),
    Random(0.0007),
    Schedule((0.0, 0.1, 0.25), (2, 0, 1)),
    Schedule((0.0, 0.1, 0.25), (2, 0, 1), repeat=0.4),
    Schedule((0.0,), (1,)),
]


@given(switching=st.sampled_from(SWITCHES), cuts=st.lists(st.integers(0, 400), max_size=10))
def test_chunks_do_not_change_the_weights(switching, cuts):
    cuts = sorted(cuts)
    topology = Topology(PRESETS["ring"], switching, seed=3)
    senders = (1, 2, 3, 4, 5)
    stream = topology.weights(6, senders, period=2, h=0.005, length=400)
    parts = [stream.rows(b - a) for a, b in zip([0, *cuts], [*cuts, 400], strict=True)]
    whole = rows(topology, 6, senders, 400, period=2)
    assert np.array_equal(np.concatenate(parts), whole)
    assert whole.shape == (400, 5) and whole.dtype == np.float64
    assert stream.row == 400
    with pytest.raises(RunError, match="rows 400 to 401 of edge weights opened for 400"):
        stream.rows(1)


def test_one_graph_is_there_always():
    static = Topology((CHAIN,), Static(), seed=0)
    assert rows(static, 3, (1, 2), 50).tolist() == [[0.0, 0.5]] * 50
    assert rows(static, 2, (), 5).shape == (5, 0)


@given(
    period=st.integers(1, 40),
    h=st.sampled_from([0.001, 0.005, 0.0125]),
    repeat=st.sampled_from([None, 0.4, 0.31]),
)
def test_a_schedule_holds_from_its_times_on(period, h, repeat):
    """At a look at t: the last graph whose time is not after t, exactly."""
    times = (0.0, 0.1, 0.25, 0.3)
    topology = Topology((CHAIN, BACK), Schedule(times, (0, 1, 0, 1), repeat), seed=0)
    expected = []
    for k in range(200):
        t = k * period * decimal_fraction(h)
        t = t % decimal_fraction(repeat) if repeat else t
        expected.append([0.0, 1.0][sum(decimal_fraction(x) <= t for x in times) % 2 == 0])
    assert rows(topology, n=200, period=period, h=h)[:, 0].tolist() == expected


def test_random_graphs_are_equally_likely_and_may_repeat():
    """40 000 draws of three graphs; tolerance 1 % of all."""
    topology = Topology(PRESETS["ring"], Random(0.15), seed=0)
    ring = rows(topology, 2, (1,), 40_000 * 30)[:, 0].reshape(-1, 30)
    assert (ring == ring[:, :1]).all()  # 30 samples of 5 ms a draw
    drawn = ring[:, 0]
    assert drawn.mean() == pytest.approx(1 / 3, abs=0.01)
    again = drawn[1:][drawn[:-1] == 1]
    assert again.mean() == pytest.approx(1 / 3, abs=0.015)


@pytest.mark.parametrize("name", PRESETS)
def test_weights_are_those_of_one_graph_at_a_time(name):
    """All receivers together see, in every row, exactly one graph of the preset."""
    topology = Topology(PRESETS[name], Random(0.15), seed=1)
    everyone = range(1, 7)
    seen = np.stack([rows(topology, i, everyone, 900) for i in everyone], axis=1)  # (900, 6, 6)
    is_graph = [(seen == graph.weights).all(axis=(1, 2)) for graph in PRESETS[name]]
    assert (np.sum(is_graph, axis=0) == 1).all()
    assert all(there.any() for there in is_graph)


@given(switching=st.sampled_from(SWITCHES), a=st.integers(1, 8), b=st.integers(1, 8))
def test_receivers_of_different_rates_see_the_same_graph(switching, a, b):
    topology = Topology(PRESETS["dense"], switching, seed=2)
    fast, slow = (rows(topology, 1, (6, 4), 300 // x, x) for x in (a, b))
    common = a * b // gcd(a, b)
    n = 299 // common
    assert np.array_equal(fast[:: common // a][:n], slow[:: common // b][:n])


def test_seed_and_name_decide():
    def drawn(**changes):
        given = {"graphs": PRESETS["ring"], "switching": Random(0.005), "seed": 0, **changes}
        return rows(Topology(**given), 2, (1,), 500).tolist()

    assert drawn() == drawn()
    assert drawn() != drawn(seed=1) != drawn(name="other") != drawn()


def test_the_graphs_of_a_seed_are_pinned():
    """A change here changes every recorded run: do not make it by accident."""
    choices = Random(0.15).stream(3, Fraction(150, 1000), generator(0, "topology"))
    assert choices.take(12).tolist() == [1, 0, 2, 0, 0, 1, 2, 1, 1, 1, 2, 1]


# facts of what lasts


def test_what_lasts_decides_on_the_roots():
    both = Topology((CHAIN, BACK), Random(0.1), seed=0)
    assert both.roots == {1, 2, 3} and both.has_joint_spanning_tree
    assert both.edges == ((1, 3), (2, 1), (3, 2)) == both.union.edges
    ends = Topology((CHAIN, BACK), Schedule((0.0, 1.0), (1, 0)), seed=0)
    assert ends.roots == {1} and ends.edges == both.edges
    dies = Topology((CHAIN, BACK, NONE), Schedule((0.0, 1.0, 2.0), (0, 1, 2)), seed=0)
    assert not dies.has_joint_spanning_tree
    again = Topology((CHAIN, BACK, NONE), Schedule((0.0, 1.0, 2.0), (0, 1, 2), 3.0), seed=0)
    assert again.roots == {1, 2, 3}
    assert Topology((BACK,), Static(), seed=0).roots == frozenset()


def test_facts_are_plain_and_complete():
    topology = Topology((CHAIN, BACK), Schedule((0.0, 0.5), (0, 1), 1.0), seed=7, name="net")
    assert topology.facts() == {
        "name": "net",
        "graphs": [
            {"name": "chain", "weights": [[0, 0, 0], [1, 0, 0], [0, 0.5, 0]]},
            {"name": "back", "weights": [[0, 0, 1], [0, 0, 0], [0, 0, 0]]},
        ],
        "switching": "schedule",
        "times": [0.0, 0.5],
        "indices": [0, 1],
        "repeat": 1.0,
        "seed": 7,
    }


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Random(0.0), "dwell = 0 s; expected a time greater than 0"),
        (lambda: Schedule((), ()), "0 times and 0 graphs; expected equally many, at least one"),
        (lambda: Schedule((0.0, 1.0), (0,)), "2 times and 1 graphs"),
        (lambda: Schedule((0.1,), (0,)), "begins at 0.1 s; expected 0"),
        (lambda: Schedule((0.0, 1.0, 1.0), (0, 0, 0)), "1 s after 1 s; expected increasing"),
        (lambda: Schedule((0.0, 1.0), (0, 0), 1.0), "repeat = 1 s; expected more than the last"),
        (lambda: Topology((CHAIN, BACK), Static(), 0), "2 graphs without a switching rule"),
        (lambda: Topology((CHAIN,), Schedule((0.0,), (1,)), 0), "index 1; expected 0 to 0"),
        (lambda: Topology((CHAIN, PRESETS["ring"][0]), Random(1), 0), "graphs of 3, 6 robots"),
        (lambda: Topology((CHAIN,), Static(), -1), "seed -1; expected 0 or more"),
        (lambda: rows(Topology((CHAIN,), Static(), 0), 4), "robot 4; expected 1 to 3"),
        (lambda: rows(Topology((CHAIN,), Static(), 0), 1, (0,)), "robot 0; expected 1 to 3"),
        (lambda: rows(Topology((CHAIN,), Static(), 0), period=0), "periods 1, 0 ticks"),
        (lambda: rows(Topology((CHAIN,), Random(1e-9), 0)), "dwell = 1e-09 s; expected at least"),
    ],
)
def test_what_is_no_topology_is_refused(make, message):
    with pytest.raises(ScenarioError, match=message):
        make()


# as a scenario writes it


def made(folder=None, **given):
    return make_topology(**{"seed": 0, "folder": folder, "place": "s.toml at topology", **given})


def test_a_preset_is_named_and_its_schedule_uses_its_names():
    assert made(graphs="ring", dwell="150 ms").switching == Random(0.15)
    assert made(graphs="tree3", dwell=0.15).roots == {3}
    planned = made(graphs="dense", schedule=[(0, "G2"), ("50 ms", "G1")], repeat=0.1)
    assert planned.switching == Schedule((0.0, 0.05), (1, 0), 0.1)
    assert planned.graphs == PRESETS["dense"]


def test_files_are_relative_to_the_scenario(tmp_path):
    (tmp_path / "a.csv").write_text("0,1\n0,0\n")
    (tmp_path / "b.toml").write_text('[[graphs]]\nname = "up"\nweights = [[0, 0], [2, 0]]\n')
    both = made(tmp_path, graphs=["a.csv", "b.toml"], schedule=[(0, "a"), (1, "up")], repeat=2)
    assert [graph.name for graph in both.graphs] == ["a", "up"]
    assert both.roots == {1, 2}
    assert made(tmp_path, graphs="a.csv").switching == Static()


@pytest.mark.parametrize(
    "given, message",
    [
        ({"graphs": "star"}, "graphs = 'star'; expected one of ring, tree3, dense, or .csv"),
        ({"graphs": "no.csv"}, "no.csv: no such file; expected weighted graphs"),
        ({"graphs": "ring"}, "3 graphs without a switching rule"),
        ({"graphs": "ring", "dwell": "1 m"}, r"dwell = '1 m': \[m\] cannot feed \[s\]"),
        ({"graphs": "ring", "dwell": 1, "repeat": 1}, "dwell means random switching; expected no"),
        ({"graphs": "ring", "repeat": 1}, "repeat without a schedule"),
        ({"graphs": "ring", "schedule": [(0, "G4")]}, r"schedule\[0\]: graph 'G4', there is none"),
        ({"graphs": "ring", "schedule": [("0 m", "G1")]}, r"schedule\[0\] = '0 m'"),
        ({"graphs": "ring", "schedule": []}, "0 times and 0 graphs"),
    ],
)
def test_what_cannot_be_gets_a_sentence_and_its_place(tmp_path, given, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        made(tmp_path, **given)
    assert str(caught.value).startswith("s.toml at topology: ")
    assert caught.value.place == "s.toml at topology"


def test_a_name_that_two_graphs_have_is_no_name(tmp_path):
    (tmp_path / "a.csv").write_text("0,1\n0,0\n")
    with pytest.raises(ScenarioError, match="graph 'a', there is more than one among"):
        made(tmp_path, graphs=["a.csv", "a.csv"], schedule=[(0, "a")])


# ---- long-run means -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("switching", "means"),
    [
        (Random(0.15), (1 / 3, 1 / 3, 1 / 3)),
        (Schedule((0.0, 0.1), (0, 2), 0.4), (1 / 4, 0.0, 3 / 4)),
        (Schedule((0.0, 0.1), (0, 1)), (0.0, 1.0, 0.0)),
    ],
)
def test_mean_weight_is_the_share_of_time_that_the_graphs_have(
    switching: Switching, means: tuple[float, ...]
) -> None:
    """The edges (2, 1), (3, 2), (4, 3) of `ring` belong to the graphs 0, 1, 2, one each."""
    topology = Topology(PRESETS["ring"], switching, 0)
    found = [topology.mean_weight(i, i - 1, period=5, h=1e-3) for i in (2, 3, 4)]
    assert found == pytest.approx(means, abs=1e-12)


def test_mean_weight_is_that_of_the_looks_of_a_receiver() -> None:
    """Graphs in turn, 5 ms each: looks 15 ms apart always meet the first; 10 ms apart meet all."""
    switching = Schedule((0.0, 0.005, 0.010), (0, 1, 2), 0.015)
    topology = Topology(PRESETS["ring"], switching, 0)
    for period, mean in ((15, 1.0), (10, 1 / 3), (7, 1 / 3)):
        assert topology.mean_weight(2, 1, period=period, h=1e-3) == pytest.approx(mean, abs=0.07)
        stream = topology.weights(2, [1], period=period, h=1e-3)
        drawn = float(stream.rows(30_000).mean())
        assert topology.mean_weight(2, 1, period=period, h=1e-3) == pytest.approx(drawn, abs=1e-4)


def test_mean_weight_of_a_static_graph_is_its_weight() -> None:
    topology = Topology((Graph.of(2, [(2, 1, 0.7)]),), Static(), 0)
    assert topology.mean_weight(2, 1, period=1, h=1e-3) == 0.7
    with pytest.raises(ScenarioError, match="robot 3"):
        topology.mean_weight(3, 1, period=1, h=1e-3)
