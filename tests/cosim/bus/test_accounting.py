"""Response times, losses and busy time of a simulated bus, from its events."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.bus.accounting import accounts, losses
from cosim.bus.arbitration import rank
from cosim.bus.frames import REQUEST, BusEvent, BusFrame, DropCause
from cosim.bus.response import FrameStream, responses
from cosim.bus.settings import BusNodeSettings, ErrorRate, Interruption, LineLevel, ScriptedError
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, frame_bits
from cosim.bus.transmissions import Outcome, busy_share, transmissions

BIT = 1_000_000
MEGABIT = BusTiming(1e6)
LONG, SHORT = BusFrame(0x123, b"\x55" * 8), BusFrame(0x7FF, b"\x55")  # 112 and 58 bits


def requests_of(*asked: tuple[int, int, BusFrame]) -> np.ndarray:
    """Rows of (time in bits, node, frame)."""
    rows = np.zeros(len(asked), REQUEST)
    for i, (at, node, frame) in enumerate(asked):
        rows[i] = (at * BIT, node, 0, frame.row())
    return rows


def run(nodes, rows, until, **options):
    """(events, transmissions) up to `until` bits."""
    bus = SimulatedBus(MEGABIT, nodes, **options)
    bus.request_many(rows)
    events = bus.advance(until * BIT)
    return events, transmissions(events, MEGABIT, until * BIT)


def spans(rows):
    return [
        (r["start"] / BIT, r["end"] / BIT, int(r["node"]), Outcome(int(r["outcome"])).name)
        for r in rows
    ]


def test_each_identifier_has_its_times_and_its_losses():
    nodes = [BusNodeSettings("a"), BusNodeSettings("b", queue_length=1)]
    rows = requests_of((5, 0, LONG), (10, 1, SHORT), (11, 1, SHORT), (500, 0, LONG))
    events, busy = run(nodes, rows, 1000, disturbances=[ScriptedError(0x123, 30)])
    # the first attempt of 0x123 fails in bit 30: the next starts 52 bits later
    long, short = accounts(rows, events)
    assert (long.identifier, long.times.tolist()) == (0x123, [109 * BIT, 161 * BIT])
    assert (long.mean, long.worst, long.worst_queueing) == (135 * BIT, 161 * BIT, 52 * BIT)
    assert (long.errors, long.lost, long.waiting) == (1, {}, 0)
    assert (short.times.tolist(), short.worst_queueing) == ([214 * BIT], 159 * BIT)
    assert short.lost == {DropCause.OVERFLOW: 1}
    (loss,) = losses(rows, events, busy)
    assert loss == (11 * BIT, 2, 1, DropCause.OVERFLOW, {0: BIT})


def test_quantiles_and_histogram_are_those_of_the_times():
    nodes = [BusNodeSettings("a"), BusNodeSettings("b")]
    rows = requests_of(*((0, 0, LONG) for _ in range(10)))
    events, _ = run(nodes, rows, 2000)
    (account,) = accounts(rows, events)
    times = [109 + 112 * i for i in range(10)]
    assert [account.quantile(q) // BIT for q in (0, 0.1, 0.5, 0.91, 1)] == [
        times[0], times[0], times[4], times[9], times[9]
    ]  # fmt: skip
    counts, edges = account.histogram(500 * BIT)
    assert (counts.tolist(), (edges // BIT).tolist()) == ([4, 4, 2], [0, 500, 1000, 1500])
    assert counts.sum() == account.sent


def test_error_frames_belong_to_the_attempt_that_failed():
    nodes = [BusNodeSettings("a"), BusNodeSettings("b"), BusNodeSettings("c")]
    rows = requests_of((0, 0, LONG), (400, 1, SHORT))
    _, busy = run(nodes, rows, 430, disturbances=[ScriptedError(0x123, 30)])
    assert spans(busy) == [
        (0, 52, 0, "FAILED"), (52, 164, 0, "SENT"), (400, 430, 1, "UNDER_WAY")
    ]  # fmt: skip
    assert busy["code"].tolist()[0] in (1, 2)
    assert busy["senders"].tolist() == [1, 1, 1]
    shares = busy_share(busy, 0, 430 * BIT, 100 * BIT)
    assert shares[:, 0] == pytest.approx([1, 0.64, 0, 0, 1])
    assert shares[:, 1] == pytest.approx([0.52, 0, 0, 0, 0])


def test_a_lone_node_is_busy_but_for_the_time_in_which_it_suspends():
    events, busy = run([BusNodeSettings("a")], requests_of((0, 0, LONG)), 10_000)
    assert spans(busy)[0] == (0, 118, 0, "FAILED")
    assert spans(busy)[20][1] - spans(busy)[20][0] == 118
    assert spans(busy)[21][0] - spans(busy)[20][0] == 126
    assert (events["kind"] == BusEvent.FREE).sum() > 60


def test_the_winner_of_an_arbitration_has_the_bus_and_a_glitch_nobody():
    nodes = [BusNodeSettings("a"), BusNodeSettings("b"), BusNodeSettings("c")]
    rows = requests_of((0, 0, SHORT), (0, 1, LONG))
    glitch = Interruption(300 * BIT, 301 * BIT, LineLevel.DOMINANT)
    _, busy = run(nodes, rows, 1000, disturbances=[glitch])
    assert spans(busy)[:2] == [(0, 112, 1, "SENT"), (112, 170, 0, "SENT")]
    assert busy["senders"].tolist()[:2] == [2, 1]
    assert len(busy) == 3
    # dominant for a bit, five recessive bits are in order, the sixth is a stuff error
    assert spans(busy)[2] == (300, 300 + 7 + 6 + 8 + 3, -1, "FAILED")


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-4, 3e-3]))
def test_busy_time_has_no_gaps_where_frames_wait_and_no_overlaps(seed, rate):
    random = np.random.default_rng(seed)
    nodes = [BusNodeSettings(f"n{i}", queue_length=200) for i in range(4)]
    asked = []
    for at in np.sort(random.integers(0, 4000, 40)).tolist():
        node = int(random.integers(0, 4))
        asked.append((at, node, BusFrame(node + 4 * int(random.integers(0, 99)), random.bytes(4))))
    rows = requests_of(*asked)
    noise = [ErrorRate(rate)] if rate else []
    events, busy = run(nodes, rows, 30_000, disturbances=noise, seed=seed)
    assert (busy["start"][1:] >= busy["end"][:-1]).all()
    assert (busy["end"] > busy["start"]).all()
    sent = busy[busy["outcome"] == Outcome.SENT]
    assert len(sent) == (events["kind"] == BusEvent.SENT).sum() == len(rows)
    for row in sent:
        frame = asked[int(row["request"])][2]
        length = int(frame_bits(frame.identifier, frame.data).nominal) * BIT
        overload = row["end"] in events["time"][events["kind"] == BusEvent.FREE]
        joined = BIT * bool(rate)  # a disturbed bit of the intermission taken as start of frame
        assert row["end"] - row["start"] in (length, length - joined) or row["errors"] or overload
        assert row["node"] == asked[int(row["request"])][1]
    total = busy_share(busy, 0, 30_000 * BIT, 30_000 * BIT)[0, 0]
    assert total == pytest.approx((busy["end"] - busy["start"]).sum() / (30_000 * BIT))


def test_the_simulated_worst_case_stands_beside_the_analysis():
    rows = requests_of((0, 1, SHORT), (1, 0, LONG))
    events, _ = run([BusNodeSettings("a"), BusNodeSettings("b")], rows, 1000)
    streams = [
        FrameStream("long", rank(0x123), 10**7, 112_000),
        FrameStream("short", rank(0x7FF), 10**7, 58_000),
    ]
    simulated = {a.identifier: a.worst // 1000 + 3 * 1000 for a in accounts(rows, events)}
    # of the frame that blocks, one bit was over when the other was requested
    assert simulated == {0x123: 169_000, 0x7FF: 58_000}
    assert [r.worst for r in responses(streams, 1000)] == [170_000, 170_000]
