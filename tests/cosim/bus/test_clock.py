"""Nodes whose clocks are too fast or too slow, within and beyond resynchronization."""

from __future__ import annotations

import pytest

from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings, Interruption, LineLevel
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming, FrameFormat, TimingError, frame_bits

BIT = 2_000_000
FRAME = BusFrame(0x2A5, bytes.fromhex("00ff00ff0f0f55aa"))


def errors(ppm: float, frames: int = 20, frame: BusFrame = FRAME, **timing: float) -> int:
    """How many errors a receiver has whose clock is off, and how many frames arrive in the end."""
    nodes = [
        BusNodeSettings("sender"),
        BusNodeSettings("receiver", clock_ppm=ppm, **timing),
        BusNodeSettings("witness"),
    ]
    bus = SimulatedBus(BusTiming(500e3, 2e6, fd=True), nodes)
    for i in range(frames):
        bus.request(0, i * 10**9, frame)
    events = bus.advance(frames * 10**9)
    if not (events["kind"] == BusEvent.ERROR).any():
        assert (events["kind"] == BusEvent.RECEIVED).sum() == 2 * frames
    return int(((events["kind"] == BusEvent.ERROR) & (events["node"] == 1)).sum())


@pytest.mark.parametrize("ppm", [100, -100, 5_000, -5_000, 12_000, -12_000])
def test_a_receiver_follows_within_its_tolerance(ppm):
    assert errors(ppm) == 0


@pytest.mark.parametrize("ppm", [40_000, -40_000, 100_000])
def test_beyond_it_frames_are_errors(ppm):
    assert errors(ppm) > 0


def test_the_limit_is_that_of_the_bit_timing():
    """10 bits between two edges: at most sjw of a bit apart (Bosch CAN 2.0, 9)."""
    run = BusFrame(0x000, bytes(8))  # runs of five and their stuff bits: the widest edges
    assert errors(9_900, frame=run, sjw=0.1, sample_point=0.8) == 0
    assert errors(26_000, frame=run, sjw=0.1, sample_point=0.8) > 0
    assert errors(26_000, frame=run, sjw=0.3, sample_point=0.7) == 0


def test_a_late_sample_point_tolerates_less_than_the_correction_of_an_edge():
    """13 bits after the last edge are longer than what is behind the sample point."""
    assert errors(-20_000, sjw=0.3, sample_point=0.7) == 0
    assert errors(-20_000, sjw=0.3, sample_point=0.9) > 0


def test_a_data_phase_tolerates_less():
    fast = BusFrame(0x2A5, bytes(32), FrameFormat(fd=True, brs=True))
    assert errors(1_000, frame=fast) == 0
    assert errors(30_000, frame=fast) > errors(30_000, frame=BusFrame(0x2A5, b"\x55" * 8))


def test_the_transmitter_times_the_bus():
    nodes = [BusNodeSettings("fast", clock_ppm=1000), BusNodeSettings("other")]
    bus = SimulatedBus(BusTiming(500e3), nodes)
    bus.request(0, 0, FRAME)
    bus.request(1, 10**9, FRAME)
    sent = bus.advance(2 * 10**9)
    sent = sent[sent["kind"] == BusEvent.SENT]
    bits = int(frame_bits(FRAME.identifier, FRAME.data).nominal) - 3
    assert sent["time"].tolist() == [bits * 1_998_002, 10**9 + bits * BIT]


def test_a_drifting_node_goes_bus_off_when_it_sends_what_nobody_follows():
    nodes = [BusNodeSettings("bad", clock_ppm=60_000, recovers=False)]
    nodes += [BusNodeSettings(f"n{i}") for i in range(2)]
    bus = SimulatedBus(BusTiming(500e3), nodes)
    bus.request(0, 0, FRAME)
    bus.advance(100 * 10**9)
    assert bus.state(0).state == ControllerState.OFF


def test_a_bus_interrupted_for_a_time_works_again_afterwards():
    """Recessive for 5 ms: the sender sees bit errors; the frames arrive when it is over."""
    nodes = [BusNodeSettings("a"), BusNodeSettings("b")]
    cut = Interruption(10 * 10**9, 15 * 10**9, LineLevel.RECESSIVE)
    bus = SimulatedBus(BusTiming(500e3), nodes, disturbances=[cut])
    for i in range(30):
        bus.request(0, i * 10**9, FRAME)
    events = bus.advance(60 * 10**9)
    got = events[events["kind"] == BusEvent.RECEIVED]["time"]
    assert len(got) == 30
    assert not ((got > 10 * 10**9) & (got < 15 * 10**9)).any()
    assert (events["code"][events["kind"] == BusEvent.ERROR] == 1).any()


def test_a_clock_that_cannot_be_is_refused():
    with pytest.raises(TimingError, match=r"node x: found clock_ppm = 300000"):
        BusNodeSettings("x", clock_ppm=300_000)
    with pytest.raises(TimingError, match=r"node x: found sjw = 0.6"):
        BusNodeSettings("x", sjw=0.6)
