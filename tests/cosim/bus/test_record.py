"""What is recorded changes nothing of what happens on the bus; a queue keeps its order."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.bus.described import BusSimulationError
from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings, Interruption, LineLevel, QueueKind
from cosim.bus.simulation import BitCounter, SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat, frame_bits

BIT = 2_000_000
NODES = 5
QUIET = [e for e in BusEvent if e not in (BusEvent.STARTED, BusEvent.LOST, BusEvent.RECEIVED)]


def run(seed: int, record: list[BusEvent], queue: QueueKind):
    """Random traffic, with aborts and restarts at any time, also during arbitration."""
    random = np.random.default_rng(seed)
    settings = [BusNodeSettings(f"n{i}", queue, queue_length=64, inbox=64) for i in range(NODES)]
    bus = SimulatedBus(BusTiming(500e3), settings, record=record)
    found, now, asked = [], 0, 0
    for _ in range(600):
        if random.random() < 0.8:
            node, name = int(random.integers(NODES)), int(random.integers(0x100))
            asked = bus.request(node, now, BusFrame(name * 8 + node, random.bytes(1)))
        elif random.random() < 0.95:
            for node in range(NODES):
                bus.abort(node, asked - int(random.integers(8)))
        else:
            bus.reset(int(random.integers(NODES)))
        now += int(random.choice([0, 1, 3, 5, 8, 12, 40, 150])) * BIT + int(random.integers(2))
        found.append(bus.advance(now))
    found.append(bus.advance(now + 5000 * BIT))
    events = np.concatenate(found)
    assert (events["kind"] == BusEvent.SENT).sum() > 30
    return events[np.isin(events["kind"], QUIET)][["time", "kind", "node", "request", "code"]]


@pytest.mark.parametrize("queue", [QueueKind.FIFO, QueueKind.SORTED])
@pytest.mark.parametrize("seed", range(5))
def test_what_happens_does_not_depend_on_what_is_recorded(seed, queue):
    everything, little = run(seed, list(BusEvent), queue), run(seed, QUIET, queue)
    assert (everything["kind"] == BusEvent.DROPPED).sum() > 5
    assert everything.tolist() == little.tolist()


def test_events_as_tuples_are_those_of_the_array_with_their_frames():
    def ready() -> SimulatedBus:
        settings = [BusNodeSettings(f"n{i}", queue_length=500, inbox=500) for i in range(3)]
        bus = SimulatedBus(BusTiming(500e3, 2e6, fd=True), settings)
        for i in range(500):  # more events than there is room for at first
            bus.request(i % 2, 0, BusFrame(i, bytes([i % 251]), FrameFormat(fd=i % 3 == 0)))
        return bus

    array, tuples = ready(), ready()
    events, rows = array.advance(10**12), tuples.step(10**12)
    assert len(rows) > 2000
    assert events.tolist() == rows
    for event, row in zip(events, rows, strict=True):
        if row[7] in (BusEvent.SENT, BusEvent.RECEIVED):
            frame = tuples.frame_of_row(row[2])
            assert (frame.identifier, array.frame(event)) == (row[1], frame)
    with pytest.raises(BusSimulationError, match="or later"):
        tuples.step(1)


def test_the_bits_of_a_frame_are_those_of_the_analysis():
    for frame in (BusFrame(0x123, b"abc"), BusFrame(5, bytes(64), FrameFormat(fd=True, brs=True))):
        bits = frame_bits(frame.identifier, frame.data, frame.format, frame.dlc)
        assert BitCounter().bits(frame) == (bits.nominal, bits.data)


@pytest.mark.parametrize("queue", [QueueKind.FIFO, QueueKind.SORTED])
def test_a_queue_that_is_never_empty_keeps_its_order(queue):
    settings = [BusNodeSettings("a", queue, queue_length=4), BusNodeSettings("b")]
    bus = SimulatedBus(BusTiming(500e3), settings)
    sent: list[int] = []
    for i in range(40):
        bus.request(0, bus.now_ps, BusFrame(0x123, bytes([i])))
        bus.advance(bus.now_ps + 1)
        while bus.state(0).pending == 4:
            events = bus.advance(bus.now_ps + 20 * BIT)
            sent += events["request"][events["kind"] == BusEvent.SENT].tolist()
    assert sent == list(range(37))


def test_interruptions_may_be_given_in_any_order():
    parts = [Interruption(n * 100 * BIT, (n * 100 + 3) * BIT, LineLevel.DOMINANT) for n in range(5)]

    def events(disturbances: list[Interruption]) -> list[tuple[int, ...]]:
        settings = [BusNodeSettings("a"), BusNodeSettings("b")]
        bus = SimulatedBus(BusTiming(500e3), settings, disturbances=disturbances)
        for i in range(5):
            bus.request(0, i * 90 * BIT, BusFrame(0x123, bytes([i])))
        return bus.advance(3000 * BIT).tolist()

    assert events(parts) == events(parts[::-1])
