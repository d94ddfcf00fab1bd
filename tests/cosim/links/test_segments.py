"""The law "segments": its delays, losses and facts, its text in a scenario, and refusals."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.losses import Independent
from cosim.links.netem import netem
from cosim.links.segments import Segment, Segments
from cosim.links.traces import DelayTrace
from tests.cosim.links.numpy_rows import rows_of
from tests.cosim.links.tables import table_of

PERIOD = Fraction(5, 1000)
LAW = Segments(0.75, (Segment(0.63, 0.66, 1.2), Segment(0.66, 0.7, 0.3), Segment(2.0, 2.1, 0.9)))
LOST = Segments(0.1, (Segment(0.0, 0.02, 0.05), Segment(0.1, 0.12, lost=True)))
TEXT = {
    "law": "segments",
    "delay": "750 ms",
    "segments": [
        {"from": "0.63 s", "to": "660 ms", "delay": "1.2 s"},
        {"from": 0.66, "to": 0.7, "delay": 0.3},
        {"from": 2, "to": 2.1, "delay": "900 ms"},
    ],
}


def delays(law, n):
    return law.stream(PERIOD, generator(0, "x")).take(n)


def test_each_sample_has_the_delay_of_the_segment_that_contains_it():
    T = delays(LAW, 600)
    assert T[:126].tolist() == [0.75] * 126  # 0.625 s is before the first one
    assert T[126:132].tolist() == [1.2] * 6  # 0.63 to 0.655 s
    assert T[132:140].tolist() == [0.3] * 8
    assert T[140] == 0.75
    assert T[400:421].tolist() == [0.9] * 20 + [0.75]


def test_a_segment_between_two_samples_changes_none():
    assert set(delays(Segments(0.1, (Segment(0.011, 0.014, 0.2),)), 10)) == {0.1}


def test_packets_of_a_segment_are_lost():
    T = delays(LOST, 30)
    assert np.flatnonzero(np.isnan(T)).tolist() == [20, 21, 22, 23]
    assert LOST.loses_packets and not LAW.loses_packets
    assert (LOST.minimum, LOST.maximum, LOST.mean) == (0.05, 0.1, 0.1)


def test_a_delay_that_changes_no_faster_than_it_may():
    """A change from 750 ms to 300 ms at 1 s/s takes 0.45 s; back at 3 s/s a third of this."""
    law = Segments(0.75, (Segment(1.0, 2.0, 0.3), Segment(3.0, 3.1, lost=True)), 3.0, 1.0)
    T = delays(law, 800)
    t = 0.005 * np.arange(800)
    expected = np.where(t < 1.0, 0.75, np.maximum(0.3, 0.75 - (t - 1.0)))
    expected = np.where(t < 2.0, expected, np.minimum(0.75, 0.3 + 3.0 * (t - 2.0)))
    expected[600:620] = np.nan
    np.testing.assert_allclose(T, expected, atol=1e-12)
    sent_after = Segments(0.75, (Segment(1.0, 1.2, 0.3), Segment(1.2, 1.3, lost=True)), 3.0, 1.0)
    assert delays(sent_after, 500)[260] == pytest.approx(0.45)  # on its way all the time
    assert delays(Segments(0.75, (Segment(0.0, 1.0, lost=True),), 1.0), 300)[-1] == 0.75


def test_it_is_valid_for_any_stop_time():
    assert LAW.limit(PERIOD) is None
    assert table_of(delay=TEXT, ticks=10).history == 241
    assert delays(LAW, 10_000)[-1] == 0.75


@st.composite
def segment_laws(draw):
    edges = draw(st.lists(st.integers(0, 90), max_size=8, unique=True).map(sorted))
    values = st.one_of(st.none(), st.sampled_from([0.0, 0.01, 0.1, 0.25]))
    found = []
    for a, b in pairwise(edges):
        if (value := draw(values)) is not None or draw(st.booleans()):
            found.append(Segment(a / 100, b / 100, value, lost=value is None))
    return Segments(draw(st.sampled_from([0.02, 0.2])), tuple(found))


@given(law=segment_laws(), cuts=st.lists(st.integers(0, 300), max_size=8).map(sorted))
def test_it_is_the_trace_of_the_same_delays_in_any_chunks(law, cuts):
    t = np.arange(100) / 100.0
    T = np.full(100, law.delay)
    for x in law.segments:
        T[(t >= x.begin - 1e-9) & (t < x.end - 1e-9)] = x.value
    trace = DelayTrace(np.append(t, 1.0), np.append(T, law.delay))
    stream = law.stream(PERIOD, generator(0, "x"))
    parts = [stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 300], strict=True)]
    expected = trace.stream(PERIOD, generator(0, "x")).take(202)
    found = np.concatenate(parts)
    assert np.array_equal(found[:202], expected, equal_nan=True)
    assert (found[202:] == law.delay).all()


@given(law=segment_laws(), cuts=st.lists(st.integers(0, 300), max_size=8).map(sorted))
def test_ramps_do_not_depend_on_chunks_and_keep_their_speeds(law, cuts):
    law = Segments(law.delay, law.segments, 2.0, 0.4)
    stream = law.stream(PERIOD, generator(0, "x"))
    found = np.concatenate([
        stream.take(b - a) for a, b in zip([0, *cuts], [*cuts, 300], strict=True)
    ])  # fmt: skip
    assert np.array_equal(found, delays(law, 300), equal_nan=True)
    kept = np.flatnonzero(np.isfinite(found))
    speed = np.diff(found[kept]) / (np.diff(kept) * float(PERIOD))
    assert speed.max(initial=0.0) <= 2.0 + 1e-9 and speed.min(initial=0.0) >= -0.4 - 1e-9
    assert np.array_equal(np.isnan(found), np.isnan(delays(Segments(law.delay, law.segments), 300)))


@pytest.mark.parametrize("semantics", ["signal", "last-arrival", "newest-stamp", "fifo", "playout"])
def test_every_semantics_takes_it(semantics):
    playout = 1.2 if semantics == "playout" else None
    table = table_of(delay=TEXT, semantics=semantics, playout=playout)
    assert table.law == LAW
    assert np.array_equal(table.stream().rows(900), rows_of(table).take(900))


def test_a_loss_model_may_come_on_top_and_a_sum_may_contain_it():
    lossy = table_of(delay=TEXT, loss={"law": "independent", "p": 0.5}, semantics="newest-stamp")
    assert lossy.law.loss == Independent(0.5)
    total = table_of(delay={"law": "sum", "of": [TEXT, {"law": "constant", "delay": 0.1}]}).law
    assert delays(total, 130)[-1] == pytest.approx(1.3)


def test_its_facts_are_its_keys():
    assert table_of(delay=LAW.facts()).law == LAW
    packets = table_of(delay=LOST.facts(), semantics="newest-stamp")
    assert packets.law == LOST
    assert packets.facts()["delay"] == LOST.facts()
    slow = Segments(0.75, LAW.segments, 0.5, 1.0)
    assert table_of(delay=slow.facts()).law == slow


def test_netem_has_the_delay_outside_and_a_remark_for_each_segment():
    lines = netem(LOST).splitlines()
    assert lines[0] == "delay 100ms"
    assert lines[1] == "# from 0 s to 0.02 s a script has to set delay 50ms"
    assert lines[2] == "# from 0.1 s to 0.12 s a script has to set loss 100%"
    slow = netem(Segments(0.75, LAW.segments, fall=0.5))
    assert "# the delay falls by at most 0.5 s in a second: a script has to set steps\n" in slow


@pytest.mark.parametrize(
    "segments, words",
    [
        ([{"from": 1, "to": 1, "delay": 0.1}], r"segments\[0\]: from 1 s to 1 s; expected a time"),
        ([{"from": -1, "to": 1, "delay": 0.1}], r"from -1 s to 1 s"),
        ([{"from": 0, "to": 1}], r"segments\[0\]: expected either delay or lost = true"),
        ([{"from": 0, "to": 1, "delay": 0.1, "lost": True}], "expected either delay or lost"),
        ([{"from": 0, "to": 1, "delay": -0.1}], r"segments\[0\].delay = -0.1 s; expected a delay"),
        (
            [{"from": 0, "to": 1, "delay": 0.1}, {"from": 0.5, "to": 2, "delay": 0.1}],
            r"segments\[1\] begins at 0.5 s, before the one before it ends, 1 s",
        ),
        ([{"from": "1 kg", "to": 1, "delay": 0.1}], r"segments\[0\].from = '1 kg'"),
        ([{"from": 0, "to": 1, "daley": 0.1}], "daley"),
        ([{"to": 1, "delay": 0.1}], "from"),
        ("long", "segments"),
    ],
)
def test_a_segment_that_is_none_is_refused(segments, words):
    with pytest.raises(ScenarioError, match=words):
        table_of(delay={"law": "segments", "delay": 0.5, "segments": segments})


@pytest.mark.parametrize("speed", [0, -1.0])
def test_a_delay_that_cannot_change_is_refused(speed):
    with pytest.raises(ScenarioError, match=r"rise: found .* s/s; expected more than 0"):
        table_of(delay={"law": "segments", "delay": 0.5, "rise": speed})


def test_a_signal_loses_nothing():
    with pytest.raises(ScenarioError, match="packets are lost"):
        table_of(delay=LOST.facts())
