"""Worst-case response times: published numbers, and a bus that is simulated."""

from __future__ import annotations

from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.copies import replace
from cosim.bus.arbitration import rank
from cosim.bus.response import NO_ERRORS, Errors, FrameStream, responses
from cosim.bus.timing import TimingError, worst
from tests.cosim.bus.queueing import PendingFrame, arbitrate

US, MS = 1_000, 1_000_000


def stream(name: str, place: int, period: int, duration: int, jitter: int = 0) -> FrameStream:
    return FrameStream(name, rank(place), period, duration, jitter)


def test_the_example_that_refuted_the_first_analysis() -> None:
    """Davis, 2007, section 3.3: the second instance of C is the late one; 125 kbit/s."""
    set_ = [
        FrameStream("A", rank(1), 2500 * US, MS),
        FrameStream("B", rank(2), 3500 * US, MS, deadline=3250 * US),
        FrameStream("C", rank(3), 3500 * US, MS, deadline=3250 * US),
    ]
    found = responses(set_, bit_ns=8 * US)
    assert [r.worst for r in found] == [2 * MS, 3 * MS, 3500 * US]
    assert [r.meets_deadline for r in found] == [True, True, False]
    assert found[2].instances == 2
    assert found == responses(set_[::-1], bit_ns=8 * US)


def test_one_stream_waits_for_nobody() -> None:
    (only,) = responses([stream("A", 1, 10, 4, jitter=3)], 1)
    assert (only.worst, only.meets_deadline) == (7, True)


def test_more_than_the_bus_has_no_bound() -> None:
    set_ = [stream("A", 1, 10, 6), stream("B", 2, 10, 5), stream("C", 3, 1000, 5)]
    assert [r.worst for r in responses(set_, 1)] == [11, None, None]
    assert not responses(set_, 1)[2].meets_deadline


def test_errors_cost_an_error_frame_and_the_longest_again() -> None:
    a, b = stream("A", 1, 10_000, 100), stream("B", 2, 10_000, 150)
    clean = [r.worst for r in responses([a, b], 1)]
    once = [r.worst for r in responses([a, b], 1, Errors(burst=1))]
    assert clean == [250, 250]
    assert once == [250 + 31 + 100, 250 + 31 + 150]
    assert [r.worst for r in responses([a, b], 1, Errors(interval=5000))] == once
    assert responses([a], 1, Errors(interval=131))[0].worst is None
    assert NO_ERRORS.within(10**9) == 0


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(TimingError, match="priority of A at B"):
        responses([stream("A", 1, 10, 1), stream("B", 1, 10, 1)], 1)
    with pytest.raises(TimingError, match="X: found period 0"):
        stream("X", 1, 0, 1)


@st.composite
def sets(draw: st.DrawFn) -> list[FrameStream]:
    """Up to six streams that ask for at most 98 % of the bus; jitter up to two periods."""
    found: list[FrameStream] = []
    share = 0.0
    for place in range(draw(st.integers(1, 6))):
        duration = draw(st.integers(1, 12))
        period = draw(st.integers(2 * duration, 60))
        if share + duration / period <= 0.98:
            share += duration / period
            jitter = draw(st.integers(0, 2 * period))
            found.append(stream(f"m{place}", place, period, duration, jitter))
    return found


def released(
    stream_: FrameStream, phase: int, late: list[int], until: int
) -> list[tuple[int, int]]:
    """(event, request) of instances: late by at most the jitter, and queued in their order."""
    events = range(phase, until, stream_.period)
    asked = [event + late[i % len(late)] for i, event in enumerate(events)]
    return list(zip(events, accumulate(asked, max), strict=True))


def simulated(releases: dict[FrameStream, list[tuple[int, int]]]) -> dict[FrameStream, int]:
    """The longest time from an event to the end of its frame; a node sends in order."""
    owner: dict[int, tuple[FrameStream, int]] = {}
    requests = []
    for s, instances in releases.items():
        for event, at in instances:
            requests.append(PendingFrame(at, s.rank, s.duration))
            owner[id(requests[-1])] = (s, event)
    longest: dict[FrameStream, int] = dict.fromkeys(releases, 0)
    for sent in arbitrate(requests):
        s, event = owner[id(sent.request)]
        longest[s] = max(longest[s], sent.end - event)
    return longest


@given(sets(), st.data())
def test_no_run_takes_longer(set_: list[FrameStream], data: st.DataObject) -> None:
    releases = {}
    for s in set_:
        phase = data.draw(st.integers(0, s.period))
        late = data.draw(st.lists(st.integers(0, s.jitter), min_size=1, max_size=4))
        releases[s] = released(s, phase, late, 600)
    longest = simulated(releases)
    for response in responses(set_, bit_ns=1):
        assert response.worst is not None
        assert longest[response.stream] <= response.worst


@given(sets(), st.data())
def test_it_is_reached_at_the_critical_instant(
    set_: list[FrameStream], data: st.DataObject
) -> None:
    """The longest of lower priority has just begun, all others are asked for, most late first."""
    found = responses(set_, bit_ns=1)
    place = data.draw(st.integers(0, len(set_) - 1))
    response = found[place]
    lower = [r.stream for r in found[place + 1 :]]
    until = 1 + (response.instances + 2) * response.stream.period
    releases = {}
    for r in found[: place + 1]:
        s = r.stream
        events = range(1 - s.jitter, until, s.period)
        releases[s] = [(event, max(event, 1)) for event in events]
    if lower:
        longest = max(lower, key=lambda s: s.duration)
        # it began a bit before: then all of it is still to come, as the analysis has it
        releases[replace(longest, duration=longest.duration + 1)] = [(0, 0)]
    assert simulated(releases)[response.stream] == response.worst


def test_a_node_that_sends_in_order_can_take_longer() -> None:
    urgent, slow = stream("urgent", 1, 1000, 10), stream("slow", 9, 1000, 10)
    other = stream("other", 5, 1000, 400)
    bound = responses([urgent, slow, other], 1)[0].worst
    requests = [
        PendingFrame(0, rank(7), 10, node=2),
        PendingFrame(1, slow.rank, slow.duration, node=0),
        PendingFrame(2, urgent.rank, urgent.duration, node=0),
        PendingFrame(3, other.rank, other.duration, node=1),
    ]
    ends = {s.request.rank: s.end for s in arbitrate(requests, fifo=True)}
    assert bound is not None
    assert ends[urgent.rank] - 2 > bound
    assert {s.request.rank: s.end for s in arbitrate(requests)}[urgent.rank] == 20


def test_worst_frames_give_the_durations() -> None:
    """Two nodes at 1 kHz, 1 Mbit/s, eight bytes: three frames of 135 us."""
    c = int(worst(8).nominal) * US
    found = responses([stream(f"xi{i}", 0x2A1 + i, MS, c) for i in range(3)], US)
    assert [r.worst for r in found] == [270 * US, 405 * US, 405 * US]


def fifo_simulated(
    releases: dict[FrameStream, list[tuple[int, int]]], nodes: dict[FrameStream, int]
) -> dict[FrameStream, int]:
    """As `simulated`, with queues in the order of requests: `nodes` says in which a stream is."""
    owner: dict[int, tuple[FrameStream, int]] = {}
    requests = []
    for s, instances in releases.items():
        for event, at in instances:
            requests.append(PendingFrame(at, s.rank, s.duration, nodes[s]))
            owner[id(requests[-1])] = (s, event)
    longest: dict[FrameStream, int] = dict.fromkeys(releases, 0)
    for sent in arbitrate(requests, fifo=True):
        s, event = owner[id(sent.request)]
        longest[s] = max(longest[s], sent.end - event)
    return longest


@given(sets(), st.data())
def test_no_run_with_fifo_queues_takes_longer(set_: list[FrameStream], data: st.DataObject) -> None:
    """Streams in two FIFO queues and alone; slowed down so that most have a bound."""
    set_ = [replace(s, period=4 * s.period) for s in set_]
    queues = [data.draw(st.sampled_from(["", "a", "b"])) for _ in set_]
    set_ = [replace(s, queue=q) for s, q in zip(set_, queues, strict=True)]
    nodes = {s: {"a": 1, "b": 2}.get(s.queue, 10 + i) for i, s in enumerate(set_)}
    releases = {}
    for s in set_:
        phase = data.draw(st.integers(0, s.period))
        late = data.draw(st.lists(st.integers(0, s.jitter), min_size=1, max_size=4))
        releases[s] = released(s, phase, late, 2400)
    longest = fifo_simulated(releases, nodes)
    for response in responses(set_, bit_ns=1):
        if response.worst is not None:
            assert longest[response.stream] <= response.worst


def test_a_fifo_queue_lets_the_urgent_wait_for_its_own_node() -> None:
    urgent, slow = stream("urgent", 1, 1000, 10), stream("slow", 9, 1000, 10)
    other = stream("other", 5, 1000, 400)
    sorted_ = responses([urgent, slow, other], 1)
    shared = [replace(urgent, queue="a"), replace(slow, queue="a"), other]
    fifo = responses(shared, 1)
    assert [r.worst for r in sorted_] == [410, 420, 420]
    # `slow` is at the head: `other` goes first, then both of the queue
    assert [r.worst for r in fifo] == [420, 420, 420]
    requests = [
        PendingFrame(0, rank(9), 10, node=1),
        PendingFrame(0, rank(1), 10, node=1),
        PendingFrame(0, rank(5), 400, node=2),
    ]
    assert arbitrate(requests, fifo=True)[-1].end == 420


def test_the_frames_of_a_fifo_queue_come_with_more_jitter_for_others() -> None:
    hidden = [replace(stream(f"h{i}", i, 100, 10), queue="a") for i in (1, 9)]
    below = stream("below", 5, 200, 10)
    alone = responses([stream("h1", 1, 100, 10), below, stream("h9", 9, 100, 10)], 1)
    fifo = responses([*hidden, below], 1)
    waits = {r.stream.name: r.waiting for r in fifo}
    assert waits == {"h1": 20, "h9": 20, "below": 0}
    assert alone[1].worst == 30
    assert fifo[1].worst == 30


def test_a_fifo_queue_that_is_not_empty_in_time_has_no_bound() -> None:
    crowded = [replace(stream(f"m{i}", i, 100, 30), queue="a") for i in range(4)]
    free = stream("free", 9, 1000, 30)
    first = stream("first", rank(0), 1000, 30)
    found = responses([*crowded, free], 1)
    assert [r.worst for r in found] == [None] * 5
    assert not found[0].meets_deadline
    above = replace(first, rank=-1)
    assert responses([*crowded, above], 1)[0].worst == 60


def test_the_sae_messages_in_fifo_queues_take_longer_than_sorted() -> None:
    """17 messages of six nodes: bytes, period (ms), sender; the first needs 1.54 ms when sorted."""
    sent = [
        (1, 50, 0), (2, 5, 1), (1, 5, 2), (2, 5, 3), (1, 5, 4), (2, 5, 5), (6, 10, 5), (1, 10, 0),
        (2, 10, 2), (2, 10, 3), (1, 50, 1), (4, 100, 0), (1, 100, 1), (1, 100, 4), (3, 1000, 0),
        (1, 1000, 4), (1, 1000, 5),
    ]  # fmt: skip
    plain = [
        stream(str(i), i, period * MS, int(worst(size).total) * 2 * US, MS // 10)
        for i, (size, period, _) in enumerate(sent)
    ]  # 500 kbit/s
    queued = [replace(s, queue=f"n{x[2]}") for s, x in zip(plain, sent, strict=True)]
    sorted_ = [r.worst for r in responses(plain, 2 * US)]
    fifo = [r.worst for r in responses(queued, 2 * US)]
    assert all(
        f is not None and s is not None and f >= s for f, s in zip(fifo, sorted_, strict=True)
    )
    assert fifo[0] > 3 * sorted_[0]
