"""Messages of several frames: counts by another implementation, times by bounds."""

from __future__ import annotations

from itertools import pairwise

import isotp
import numpy as np
import pytest

from cosim.bus.fragments import flow_controls, isotp_frames
from cosim.bus.response import FrameStream, responses
from cosim.bus.timing import BusTiming, FrameFormat, TimingError, padded, worst
from cosim.bus.transfers import IsoTpSettings, OtherMessage, Transfer, TransferSimulation

FD = BusTiming(1e6, 5e6, fd=True)
MS, US = 10**9, 10**6


def frames_of_can_isotp(length: int, unit: int, block: int) -> tuple[list[int], int]:
    """Bytes of the data frames, and the number of flow controls, by python-can-isotp."""
    wires: list[list[isotp.CanMessage]] = [[], []]
    sent: list[list[int]] = [[], []]
    addresses = [isotp.Address(rxid=2 - i, txid=1 + i) for i in range(2)]

    def end(i: int) -> isotp.TransportLayerLogic:
        def put(message: isotp.CanMessage) -> None:
            sent[i].append(len(message.data))
            wires[1 - i].append(message)

        def get(timeout: float) -> isotp.CanMessage | None:
            return wires[i].pop(0) if wires[i] else None

        parameters = {
            "tx_data_length": unit, "can_fd": unit > 8, "blocksize": block, "stmin": 0,
            "tx_padding": 0, "tx_data_min_length": 8,
        }  # fmt: skip
        return isotp.TransportLayerLogic(get, put, addresses[i], params=parameters)

    ends = [end(0), end(1)]
    ends[0].send(bytes(length))
    for _ in range(20_000):
        for layer in ends:
            layer.process()
        if ends[1].available():
            break
    assert ends[1].recv() == bytes(length)
    return sent[0], len(sent[1])


@pytest.mark.parametrize("unit", [8, 12, 32, 64])
@pytest.mark.parametrize("block", [0, 1, 4])
def test_frames_and_flow_controls_are_those_of_can_isotp(unit: int, block: int) -> None:
    for length in (1, 6, 7, 8, 10, 11, 30, 31, 61, 62, 63, 64, 89, 125, 126, 188, 400, 1500):
        expected, controls = frames_of_can_isotp(length, unit, block)
        found = isotp_frames(length, unit)
        assert list(found) == expected, length
        assert flow_controls(len(found), block) == controls


@pytest.mark.parametrize(("length", "unit"), [(0, 8), (4096, 64), (10, 9), (10, 4)])
def test_what_iso_tp_does_not_have_is_refused(length: int, unit: int) -> None:
    with pytest.raises(TimingError, match="expected"):
        isotp_frames(length, unit)


def test_one_frame_has_the_bound_of_the_response_time_analysis() -> None:
    rng = np.random.default_rng(3)
    kind = FrameFormat(fd=True, brs=True)
    for _ in range(50):
        others = tuple(
            OtherMessage(
                int(i), padded(int(rng.integers(1, 65)), fd=True), int(rng.integers(2, 40)) * MS
            )
            for i in rng.choice(np.arange(1, 0x7FF), 6, replace=False)
            if i != 0x400
        )
        transfer = Transfer(FD, 0x400, (48,), others=others)
        streams = [
            FrameStream(hex(o.identifier), o.identifier << 21, o.period_ps // 1000,
                        FD.time_ns(worst(o.length, kind)))
            for o in others
        ]  # fmt: skip
        own = FrameStream("own", 0x400 << 21, 10**9, FD.time_ns(worst(48, kind)))
        bound = next(r for r in responses([*streams, own], FD.bit_ns) if r.stream is own)
        assert transfer.longest_ps == pytest.approx(bound.worst * 1000, abs=20_000)


def simulated(transfer: Transfer, seed: int, period: int, count: int) -> np.ndarray:
    """The times of so many messages, ps, with random phases of the others."""
    rng = np.random.default_rng(seed)
    phases = [int(rng.integers(0, o.period_ps)) for o in transfer.others]
    bus = TransferSimulation(transfer, phases, seed)
    return np.array([bus.deliver(k * period) - k * period for k in range(count)])


@pytest.mark.parametrize("seed", range(12))
def test_simulated_times_are_within_the_bounds(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    others = tuple(
        OtherMessage(int(i), 64, int(rng.integers(1, 8)) * MS + int(rng.integers(0, MS)))
        for i in rng.choice(np.arange(1, 0x3FF), 4, replace=False)
    )
    others += (OtherMessage(0x700, 64, 2 * MS),)
    lengths = (64,) * int(rng.integers(1, 9)) + (int(rng.integers(9, 64)),)
    flow = None
    if seed % 2:
        gaps = int(rng.integers(0, 3)) * 300 * US
        flow = IsoTpSettings(0x401, gaps, int(rng.integers(0, 4)), 100 * US)
    lengths = tuple(padded(n, fd=True) for n in lengths)
    transfer = Transfer(FD, 0x400, lengths, others=others, isotp=flow)
    assert transfer.longest_ps is not None
    found = simulated(transfer, seed, 60 * MS, 40)
    assert transfer.shortest_ps <= found.min() and found.max() <= transfer.longest_ps
    assert found.max() > transfer.shortest_ps  # traffic is in the way


def test_consecutive_frames_keep_their_gap_and_blocks_their_flow_controls() -> None:
    """A board that asks for 5 ms and blocks of four (nano-ros pull request 70)."""
    flow = IsoTpSettings(0x401, 5 * MS, 4, 100 * US)
    transfer = Transfer(FD, 0x400, isotp_frames(1500, 64), isotp=flow)
    bus = TransferSimulation(transfer, keeps=True)
    bus.deliver(0)
    data = [(at, n) for at, identifier, n in bus.sent if identifier == 0x400]
    assert len(data) == len(transfer.lengths) == 24
    controls = [at for at, identifier, _ in bus.sent if identifier == 0x401]
    assert len(controls) == -(-23 // 4) == flow_controls(24, 4)
    for (a, _), (b, n) in pairwise(data[1:]):
        frame = transfer.time_ps(worst(n, transfer.format))
        assert 5 * MS <= b - a <= 5 * MS + frame


def test_a_flood_of_higher_priority_delays_and_keeps_the_order() -> None:
    free = Transfer(FD, 0x400, (64,) * 10)
    frame = free.time_ps(worst(64, free.format))
    flooded = Transfer(FD, 0x400, (64,) * 10, others=(OtherMessage(0x100, 64, 2 * frame),))
    alone, beside = (simulated(x, 1, 50 * MS, 20) for x in (free, flooded))
    assert beside.min() > 1.5 * alone.max()  # the flood takes nearly half of the bus
    assert flooded.longest_ps is not None and beside.max() <= flooded.longest_ps
    below = Transfer(FD, 0x400, (64,) * 10, others=(OtherMessage(0x500, 64, 2 * frame),))
    assert simulated(below, 1, 50 * MS, 20).max() <= alone.max() + 1.1 * frame
    bus = TransferSimulation(flooded, keeps=True)
    bus.deliver(0)
    assert len(bus.sent) == 10


def test_a_bus_without_room_has_no_bound() -> None:
    frame = Transfer(FD, 0x400, (64,)).time_ps(worst(64, FrameFormat(fd=True, brs=True)))
    full = Transfer(FD, 0x400, (64,), others=(OtherMessage(0x100, 64, frame),))
    assert full.longest_ps is None


def test_transfers_that_cannot_be_are_refused() -> None:
    with pytest.raises(TimingError, match="one identifier in two messages"):
        Transfer(FD, 0x400, (8,), others=(OtherMessage(0x400, 8, MS),))
    with pytest.raises(TimingError, match="answer after 1 us"):
        Transfer(FD, 0x400, (8,), isotp=IsoTpSettings(0x401, answer_ps=US))
