"""Traffic for a simulated bus: periodic, babbling, random, of a DBC file, of a log."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cosim.bus.accounting import accounts, losses
from cosim.bus.dbc_traffic import dbc_sources, read_messages, senders
from cosim.bus.frames import FRAME, REQUEST, BusEvent, BusFrame, DropCause
from cosim.bus.settings import BusNodeSettings
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat
from cosim.bus.traffic import (
    LogSource,
    PeriodicSource,
    RandomSource,
    TrafficError,
    babbling,
    merged,
    random_load,
)
from cosim.bus.transmissions import busy_share, transmissions

MS = 10**9
TIMING = BusTiming(500e3)
ROOT = Path(__file__).parents[3]


def test_a_periodic_message_comes_at_its_period():
    source = PeriodicSource(3, BusFrame(0x123, b"\1\2"), 10 * MS, offset_ps=2 * MS)
    rows = source.requests(0, 35 * MS)
    assert rows["at"].tolist() == [2 * MS, 12 * MS, 22 * MS, 32 * MS]
    assert set(rows["node"].tolist()) == {3}
    assert (rows["frame"][0]["id"], rows["frame"][0]["data"][:3].tolist()) == (0x123, [1, 2, 0])


@pytest.mark.parametrize(
    "source",
    [
        PeriodicSource(0, BusFrame(1, bytes(8)), 10 * MS, 3, 40 * MS, 7, random_data=True),
        PeriodicSource(
            0, BusFrame(1, bytes(8)), 7 * MS, 0, MS, 1, start_ps=50 * MS, end_ps=150 * MS
        ),
        RandomSource((0, 1), 3000.0, seed=5),
    ],
)
def test_requests_do_not_depend_on_how_time_is_cut(source):
    whole = source.requests(0, 400 * MS)
    cuts = [0, 1, 17 * MS, 17 * MS + 3, 99 * MS, 250 * MS, 400 * MS]
    parts = [source.requests(a, b) for a, b in pairwise(cuts)]
    assert len(whole) > 10
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert (np.diff(whole["at"]) >= 0).all()


def test_jitter_is_random_between_none_and_all():
    source = PeriodicSource(0, BusFrame(1), 10 * MS, jitter_ps=2 * MS, seed=1)
    late = source.requests(0, 10_000 * MS)["at"] % (10 * MS)
    assert 0 <= late.min() < 0.02 * MS
    assert 1.98 * MS < late.max() <= 2 * MS
    assert late.mean() == pytest.approx(MS, rel=0.1)
    other = PeriodicSource(0, BusFrame(1), 10 * MS, jitter_ps=2 * MS, seed=2)
    assert (other.requests(0, 1000 * MS)["at"] != source.requests(0, 1000 * MS)["at"]).any()


def test_a_babbling_node_keeps_the_bus_and_everybody_else_off_it():
    nodes = [BusNodeSettings("victim", queue_length=3), BusNodeSettings("babbler", queue_length=2)]
    timing = BusTiming(500e3)
    sources = [
        PeriodicSource(0, BusFrame(0x100, bytes(8)), 5 * MS),
        babbling(1, BusFrame(0x000, b"\x55" * 8), timing, 20 * MS, 60 * MS),
    ]
    rows = merged(sources, 0, 100 * MS)
    bus = SimulatedBus(timing, nodes)
    bus.request_many(rows)
    events = bus.advance(100 * MS)
    sent = events[(events["kind"] == BusEvent.SENT) & (events["node"] == 0)]["time"]
    # with the frame that was requested just before, at 20 ms, nothing else until it is over
    assert ((sent > 20.5 * MS) & (sent < 60 * MS)).sum() == 0
    assert (sent > 60 * MS).sum() >= 8 + 2
    busy = transmissions(events, timing, 100 * MS)
    shares = busy_share(busy, 0, 100 * MS, 10 * MS)[:, 0]
    assert shares[3:6] == pytest.approx([1, 1, 1], abs=0.001)
    assert shares[7] < 0.1
    lost = losses(rows, events, busy)
    assert len(lost) >= 4
    assert {x.node for x in lost} == {0}
    assert all(next(iter(x.blocked_by)) == 1 for x in lost)  # the babbler had the bus
    half = babbling(1, BusFrame(0, b"\x55" * 8), timing, 0, 100 * MS, share=0.5)
    assert len(half.requests(0, 100 * MS)) == pytest.approx(0.5 * 100 * MS / (113 * 2e6), abs=2)


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_random_load_has_its_share(share):
    nodes = [BusNodeSettings(f"n{i}") for i in range(4)]
    bus = SimulatedBus(TIMING, nodes, record=[BusEvent.STARTED, BusEvent.SENT, BusEvent.LOST])
    rows = random_load(share, range(4), TIMING, seed=3).requests(0, 2000 * MS)
    events = []
    for start in range(0, 2000, 100):
        part = rows[(rows["at"] >= start * MS) & (rows["at"] < (start + 100) * MS)]
        bus.request_many(part)
        events.append(bus.advance((start + 100) * MS))
    busy = transmissions(np.concatenate(events), TIMING, 2000 * MS)
    found = busy_share(busy, 0, 2000 * MS, 2000 * MS)[0, 0]
    assert found == pytest.approx(share, rel=0.05)
    owner = {int(r["frame"]["id"]): int(r["node"]) for r in rows}
    assert all(owner[int(r["frame"]["id"])] == r["node"] for r in rows)


def test_a_recorded_log_sent_again_gives_the_same_run():
    nodes = [BusNodeSettings(f"n{i}", queue_length=500) for i in range(4)]
    bus = SimulatedBus(TIMING, nodes)
    bus.request_many(random_load(0.7, range(4), TIMING).requests(0, 300 * MS))
    events = bus.advance(400 * MS)
    sent = events[events["kind"] == BusEvent.SENT]
    frames = np.array([bus.frame(row).row() for row in sent], FRAME)
    log = LogSource(0, sent["time"], frames, TIMING)
    again = SimulatedBus(TIMING, nodes)
    again.request_many(log.requests(0, 400 * MS))
    found = again.advance(400 * MS)
    found = found[found["kind"] == BusEvent.SENT]
    assert len(sent) > 500
    assert found["time"].tolist() == sent["time"].tolist()
    with pytest.raises(TrafficError, match="times that go back"):
        LogSource(0, sent["time"][::-1], frames, TIMING)


def test_a_dbc_file_is_traffic():
    messages = read_messages(ROOT / "configs/can/link_fd2.dbc")
    named = {m.name: m for m in messages}
    link = named["LINK_1"]
    assert (link.identifier, link.length, link.format.fd) == (0x3A1, 24, True)
    assert link.period_ps == 5 * MS or link.period_ps > 0
    nodes = {name: i for i, name in enumerate(senders(messages))}
    assert nodes["N1"] != nodes["N2"]
    rows = merged(dbc_sources(messages, nodes, jitter=0.1, seed=1), 0, 100 * MS)
    mine = rows[rows["frame"]["id"] == 0x3A1]
    assert len(mine) == pytest.approx(100 * MS / link.period_ps, abs=1)
    assert set(mine["node"].tolist()) == {nodes["N1"]}
    assert len({r["frame"]["data"].tobytes() for r in mine}) == len(mine)
    assert not rows["frame"]["data"][:, 24:].any()


def test_the_dbc_reader_agrees_with_cantools():
    from cantools import database

    for name in ("link.dbc", "link_fd.dbc", "link2.dbc", "link_fd2.dbc"):
        path = ROOT / "configs/can" / name
        theirs = {
            m.frame_id: (m.name, m.length, m.is_fd, m.is_extended_frame, m.cycle_time)
            for m in database.load_file(path).messages
            if m.cycle_time
        }
        ours = {
            m.identifier: (m.name, m.length, m.format.fd, m.format.extended, m.period_ps / MS)
            for m in read_messages(path)
        }
        assert ours == theirs


def test_traffic_that_cannot_be_is_refused(tmp_path):
    with pytest.raises(TrafficError, match=r"identifier 0x1: found a period of 0 s"):
        PeriodicSource(0, BusFrame(1), 0)
    with pytest.raises(TrafficError, match="found a load of 120%"):
        random_load(1.2, [0], TIMING)
    with pytest.raises(TrafficError, match="0 nodes"):
        RandomSource((), 10.0)
    with pytest.raises(TrafficError, match="found a share of 0"):
        babbling(0, BusFrame(1), TIMING, share=0)
    path = tmp_path / "no.dbc"
    with pytest.raises(TrafficError, match="expected a DBC file"):
        read_messages(path)
    path.write_text("BO_ 5 M: 8 N1\n")
    with pytest.raises(TrafficError, match="no message with a GenMsgCycleTime"):
        read_messages(path)
    path.write_text('BO_ 5 M: 70 N1\nBA_ "GenMsgCycleTime" BO_ 5 10;\n')
    with pytest.raises(TrafficError, match="message M: found 70 bytes"):
        read_messages(path)


def test_an_fd_source_fills_all_lengths():
    fd = FrameFormat(fd=True, brs=True)
    source = RandomSource((0,), 5000.0, lengths=(3, 20, 64), format=fd, seed=2)
    rows = source.requests(0, 200 * MS)
    assert set(rows["frame"]["length"].tolist()) == {3, 20, 64}
    assert rows.dtype == REQUEST
    long = rows[rows["frame"]["length"] == 20]
    assert not long["frame"]["data"][:, 20:].any()
    assert long["frame"]["data"][:, :20].any(axis=0).all()


def test_a_queue_that_is_too_short_is_named_as_the_cause():
    nodes = [BusNodeSettings("a", queue_length=1), BusNodeSettings("b")]
    rows = np.zeros(3, REQUEST)
    for i in range(3):
        rows[i] = (i, 0, 0, BusFrame(0x10 + i, bytes(8)).row())
    bus = SimulatedBus(TIMING, nodes)
    bus.request_many(rows)
    events = bus.advance(10 * MS)
    lost = losses(rows, events, transmissions(events, TIMING, 10 * MS))
    assert [(x.request, x.cause) for x in lost] == [
        (1, DropCause.OVERFLOW), (2, DropCause.OVERFLOW)
    ]  # fmt: skip
    assert [a.lost for a in accounts(rows, events)][1:] == [{DropCause.OVERFLOW: 1}] * 2
