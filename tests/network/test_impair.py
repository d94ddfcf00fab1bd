"""The laws of the relay are those of the links, drawn the same way."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.relay.impairment import Impairment, RelayLinkSpec
from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.frozen import frozen
from cosim.links.presets import preset
from cosim.links.spec import delay_law, loss_model

MS = 1_000_000
UNIFORM = {"law": "uniform", "low": "300 ms", "high": "1200 ms", "hold": "30 ms"}
BURSTS = {"law": "gilbert-elliott", "p": 0.01, "r": 0.1, "1-h": 0.7, "1-k": 0.001}


def link(seed: int = 0, **spec: object) -> Impairment:
    return Impairment("a>b", RelayLinkSpec.of(spec, "here"), seed)


def test_a_perfect_link_holds_nothing_back():
    assert [link().schedule_packet(t, 100) for t in (0, 5, 5)] == [(0, 0), (0, 5), (0, 5)]


def test_delays_are_the_laws_by_time():
    found = link(3, delay=UNIFORM, ordered=False)
    law = delay_law(UNIFORM, Path())
    drawn = law.stream(Fraction(1, 1000), generator(3, "a>b delay")).take(5000)
    for k in (0, 1, 29, 30, 31, 1024, 4999):
        delay, leaves = found.schedule_packet(k * MS + 7, 100)
        assert delay == round(1e9 * drawn[k]) and leaves == k * MS + 7 + delay


def test_losses_are_the_models_by_packet():
    found = link(4, loss=BURSTS)
    lost = loss_model(BURSTS).stream(Fraction(1, 1000), generator(4, "a>b loss")).take(3000)
    assert [found.schedule_packet(7 * k, 100)[0] < 0 for k in range(3000)] == lost.tolist()
    assert lost.any() and not lost.all()


def test_a_preset_brings_its_losses_by_packet():
    found = link(4, delay={"law": "preset", "name": "wifi5"})
    own = preset("wifi5").loss
    assert own is not None
    lost = loss_model(own).stream(Fraction(1, 1000), generator(4, "a>b loss")).take(3000)
    assert [found.schedule_packet(7 * k, 100)[0] < 0 for k in range(3000)] == lost.tolist()
    assert lost.any()
    with pytest.raises(ScenarioError, match="already defines losses"):
        link(4, delay={"law": "preset", "name": "wifi5"}, loss=BURSTS)


def test_segments_of_time_have_their_own_delay_or_lose_packets():
    segments = [
        {"from": "10 ms", "to": "20 ms", "delay": "4 ms"},
        {"from": 0.03, "to": 0.04, "lost": True},
    ]
    law = {"law": "segments", "delay": "1 ms", "segments": segments}
    found = link(delay=law, ordered=False)
    delays = [found.schedule_packet(k * MS, 100)[0] for k in range(50)]
    assert delays == [MS] * 10 + [4 * MS] * 10 + [MS] * 10 + [-1] * 10 + [MS] * 10


def test_a_trace_loses_what_it_lost():
    found = link(delay={"law": "frozen", "name": "geo-up", "repeat": True}, ordered=False)
    T = frozen("geo-up").delays()
    for k in range(0, 24_000, 7):
        delay = found.schedule_packet(5 * MS * k, 100)[0]
        assert delay == (-1 if T[k] < 0 else 1000 * T[k])
    assert (T[::7] < 0).any()


@given(
    steps=st.lists(st.integers(0, 80 * MS), min_size=1, max_size=60),
    ordered=st.booleans(),
    rate=st.sampled_from([0.0, 1e5, 1e7]),
)
def test_nothing_leaves_early_and_what_is_ordered_stays_so(
    steps: list[int], ordered: bool, rate: float
):
    found = link(delay=UNIFORM, ordered=ordered, rate=rate)
    times = np.cumsum(steps).tolist()
    fates = [found.schedule_packet(t, 125) for t in times]
    for t, (delay, leaves) in zip(times, fates, strict=True):
        assert 300 * MS <= delay <= 1200 * MS
        assert leaves >= t + delay + (round(1e12 / rate) if rate else 0)
        assert ordered or rate or leaves == t + delay
    leaving = [leaves for _, leaves in fates]
    assert not ordered or leaving == sorted(leaving)


def test_a_rate_lets_packets_wait_for_each_other():
    found = link(rate=1e6)  # 125 bytes: 1 ms
    assert [found.schedule_packet(0, 125)[1] for _ in range(3)] == [1 * MS, 2 * MS, 3 * MS]
    assert found.schedule_packet(100 * MS, 125)[1] == 101 * MS


def test_a_link_that_is_down_and_up_again():
    found = link()
    found.set(RelayLinkSpec(down=True))
    assert found.schedule_packet(0, 1) == (-1, -1)
    found.set(RelayLinkSpec())
    assert found.schedule_packet(1, 1) == (0, 1)


def test_links_draw_each_on_its_own_and_seeds_differ():
    spec = RelayLinkSpec(delay=UNIFORM)
    first = [
        Impairment(n, spec, s).schedule_packet(0, 1)[0]
        for n, s in (("a>b", 0), ("b>a", 0), ("a>b", 1))
    ]
    assert len(set(first)) == 3
    assert Impairment("a>b", spec, 0).schedule_packet(0, 1)[0] == first[0]


def test_what_is_no_link():
    with pytest.raises(ScenarioError, match="a>b: unknown key 'dely'; expected one of delay, loss"):
        RelayLinkSpec.of({"dely": 1}, "a>b")
    with pytest.raises(ScenarioError, match="low"):
        link(delay={"law": "uniform", "low": "2 s", "high": "1 s"})
