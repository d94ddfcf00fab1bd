"""Nodes on hosts: the cut has the largest least delay, and the file's nodes stay where they are."""

from __future__ import annotations

from collections import Counter
from itertools import combinations, product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.deployment.system import load_system
from bridge.rehearsal.placement import LockstepCosts, Way, place, predict, ways
from tests.bridge.deployments import CONFIGS


def window(between: list[Way], hosts: dict[str, str]) -> float:
    cut = [way.lead for way in between if hosts[way.sender] != hosts[way.receiver]]
    return min(cut, default=float("inf"))


def test_near_nodes_stay_together_and_the_cut_is_where_links_are_slow() -> None:
    """Three teams of four with 1 ms inside; a ring of 300 ms between the teams."""
    names = [f"n{i}" for i in range(12)]
    between = [
        Way(names[3 * k + a], names[3 * k + b], 0.001)
        for k in range(4)
        for a, b in product(range(3), repeat=2)
        if a != b
    ]
    between += [Way(names[3 * k], names[(3 * k + 3) % 12], 0.3) for k in range(4)]
    hosts = place(names, between, {"a": 1, "b": 1}, {})
    assert window(between, hosts) == 0.3
    assert sorted(Counter(hosts.values()).values()) == [6, 6]


@given(
    edges=st.dictionaries(
        st.sampled_from([*combinations("abcdef", 2)]), st.sampled_from([1, 3, 10]), max_size=9
    )
)
def test_no_even_placement_has_a_longer_window(edges: dict[tuple[str, str], int]) -> None:
    """Against all placements of six nodes on two hosts, three on each.

    The greedy packing of groups is no optimum in general; of six nodes it is one.
    """
    between = [Way(a, b, lead) for (a, b), lead in edges.items()]
    hosts = place("abcdef", between, {"x": 1, "y": 1}, {})
    assert sorted(Counter(hosts.values()).values()) == [3, 3]
    best = max(
        window(between, {n: "x" if n in one else "y" for n in "abcdef"})
        for one in combinations("abcdef", 3)
    )
    assert window(between, hosts) == best


@given(at=st.dictionaries(st.sampled_from("abcdef"), st.sampled_from("xyz")))
def test_what_the_file_places_stays_there(at: dict[str, str]) -> None:
    between = [Way(a, b, 0.01) for a, b in zip("abcde", "bcdef", strict=True)]
    hosts = place("abcdef", between, {"x": 1, "y": 2, "z": 1}, at)
    assert set(hosts) == set("abcdef") and hosts.items() >= at.items()


def test_a_window_takes_its_computing_and_the_network() -> None:
    """Six robots, 5 ms between samples: links from 30 ms, hosts 15 ms apart: 0.5 s of waiting.

    The costs are round, so that they are counted by hand.
    """
    changes = ("graphs.net.n=6", "deploy.nodes.node.count=6", "deploy.messages.xi.count=6")
    system = load_system(CONFIGS / "many.toml", "many", changes)
    between = ways(system)
    assert min(way.lead for way in between) == 0.03
    hosts = place(tuple(system.nodes), between, {"a": 1, "b": 1}, {})
    costs = LockstepCosts(slot=1e-6, payload=1e-4, crossing=1e-3, exchange=3e-3)
    found = predict(system, between, hosts, {"a": 1, "b": 1}, 0.015, costs)
    assert (found.window, found.waiting) == (0.03, pytest.approx(0.5 + 0.1))
    into = {(way.sender, hosts[way.receiver]) for way in found.cut}
    ends = Counter(hosts[way.receiver] for way in between)
    busiest = max(
        3 * 1e-3 + (3 + ends[host]) * 1e-4 / 0.03
        + sum(to == host for _, to in into) * 1e-3 / 0.03
        for host in "ab"
    )  # fmt: skip
    assert found.computing == pytest.approx(busiest)
    assert found.seconds == pytest.approx(found.computing + found.waiting)
    one = predict(system, between, dict.fromkeys(system.nodes, "a"), {"a": 2}, 0.015, costs)
    assert (one.cut, one.waiting) == ((), pytest.approx(0.1))
    assert one.computing == pytest.approx((6 * 1e-3 + (6 + len(between)) * 1e-4 / 0.03) / 2)
