"""Error counters that the nodes of a simulated bus bring along."""

from __future__ import annotations

import pytest

from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, TimingError

BIT = 1_000_000


def bus(**first: int) -> SimulatedBus:
    nodes = [BusNodeSettings("a", **first), BusNodeSettings("b"), BusNodeSettings("c")]
    return SimulatedBus(BusTiming(1e6), nodes)


@pytest.mark.parametrize(
    ("counters", "state"),
    [
        ({"tec": 95, "rec": 7}, ControllerState.ACTIVE),
        ({"tec": 96}, ControllerState.WARNING),
        ({"rec": 128}, ControllerState.PASSIVE),
        ({"tec": 256}, ControllerState.OFF),
    ],
)
def test_the_counters_give_the_state(counters: dict[str, int], state: ControllerState) -> None:
    found = bus(**counters).state(0)
    assert (found.tec, found.rec) == (counters.get("tec", 0), counters.get("rec", 0))
    assert found.state == state


def test_they_count_on_from_there_without_an_event_for_the_state_at_the_start() -> None:
    simulated = bus(tec=128)
    simulated.request(0, 0, BusFrame(0x123))
    events = simulated.advance(100 * BIT)
    kinds = [BusEvent(k) for k in events["kind"]]
    assert kinds.count(BusEvent.STATE) == 1  # warning: 127 after the transmission
    assert simulated.state(0)[:3] == (127, 0, ControllerState.WARNING)


def test_received_frames_count_down() -> None:
    simulated = bus(rec=3)
    for _ in range(2):
        simulated.request(1, 0, BusFrame(0x123))
    simulated.advance(200 * BIT)
    assert simulated.state(0).rec == 1


def test_frames_are_computed_as_a_whole_once_nothing_is_counted() -> None:
    simulated = bus(rec=3)
    simulated.request(1, 0, BusFrame(0x123))
    simulated.advance(100 * BIT)
    assert simulated.whole_frames == 0
    simulated.reset(0)
    simulated.advance(200 * BIT)
    simulated.request(1, 200 * BIT, BusFrame(0x123))
    simulated.advance(300 * BIT)
    assert simulated.state(0).rec == 0
    assert simulated.whole_frames == 1


def test_a_node_that_starts_bus_off_is_back_after_128_times_11_bits() -> None:
    simulated = bus(tec=256)
    simulated.request(0, 0, BusFrame(0x123))
    events = simulated.advance(2000 * BIT)
    (back,) = events[events["kind"] == BusEvent.RECOVERED]
    assert back["time"] == 1408 * BIT
    (sent,) = events[events["kind"] == BusEvent.SENT]
    assert sent["time"] == (1408 + 48 - 3) * BIT


@pytest.mark.parametrize("counters", [{"tec": 257}, {"rec": -1}])
def test_counters_that_cannot_be_are_refused(counters: dict[str, int]) -> None:
    with pytest.raises(TimingError, match="expected 0 to 25"):
        bus(**counters)
