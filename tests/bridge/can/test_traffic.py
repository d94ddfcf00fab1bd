"""Counters of a bus: bits by the fields of ISO 11898-1, and the slots of the last seconds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.native.bus import TrafficStruct, traffic_add
from bridge.native.frame import Flags, Frame

SLOT, SLOTS = 100_000_000, 16
BASE = {"SOF": 1, "identifier": 11, "RTR": 1, "IDE": 1, "r0": 1, "DLC": 4, "CRC": 15}
LONG = BASE | {"SRR": 1, "extension": 18, "r1": 1}
END = {"CRC delimiter": 1, "ACK": 1, "ACK delimiter": 1, "EOF": 7, "interframe": 3}
FD = {"SOF": 1, "identifier": 11, "RRS": 1, "IDE": 1, "FDF": 1, "res": 1, "BRS": 1}
LONG_FD = FD | {"SRR": 1, "extension": 18}
STUFF = 1 / 30  # bits on the average of random data


def bits(length, flags):
    """(bits, bits of the data phase) of a frame, stuff bits included."""
    extended = bool(flags & Flags.EXTENDED)
    data = 0 if flags & Flags.REMOTE else 8 * length
    if not flags & Flags.FD:
        stuffed = sum((LONG if extended else BASE).values()) + data
        return stuffed * (1 + STUFF) + sum(END.values()), 0
    arbitration = sum((LONG_FD if extended else FD).values()) * (1 + STUFF)
    arbitration += sum(END.values()) - 1  # the CRC delimiter belongs to the data phase
    short = length <= 16
    phase = (1 + 4 + data) * (1 + STUFF) + 4 + (17 if short else 21) + (6 if short else 7) + 1
    return (arbitration, phase) if flags & Flags.BRS else (arbitration + phase, 0)


FORMATS = [0, Flags.EXTENDED, Flags.REMOTE, Flags.EXTENDED | Flags.REMOTE]
FORMATS += [Flags.FD | brs | long for brs in (0, Flags.BRS) for long in (0, Flags.EXTENDED)]


@pytest.mark.parametrize("flags", FORMATS)
@pytest.mark.parametrize("length", [0, 1, 8, 12, 16, 20, 64])
def test_a_frame_has_the_bits_of_its_fields(length, flags):
    if length > 8 and not flags & Flags.FD:
        return
    traffic = TrafficStruct()
    for n in (1, 2):
        traffic_add(traffic, Frame.of(1, bytes(length), int(flags)))
        expected = [n * x for x in bits(length, flags)]
        assert [traffic.bits, traffic.data_bits] == pytest.approx(expected)
        assert [traffic.slot_bits[0], traffic.slot_data_bits[0]] == pytest.approx(expected)


@given(st.lists(st.tuples(st.integers(-6, 6), st.sampled_from([1, 0, SLOT - 1])), max_size=60))
def test_slots_hold_the_last_frames_and_older_ones_are_not_counted(steps):
    traffic, newest, count, at = TrafficStruct(), {}, {}, 40
    total = 0
    for step, part in steps:
        at = max(0, at + 3 * step)
        place = at % SLOTS
        if at >= newest.get(place, 0):
            if newest.get(place, 0) != at:
                count[place] = 0
            newest[place] = at
            count[place] = count.get(place, 0) + 1
            total += 1
        traffic_add(traffic, Frame.of(1, bytes(8), int(Flags.FD | Flags.BRS), at * SLOT + part))
        assert traffic.frames == total
        for slot in range(SLOTS):
            frames = count.get(slot, 0)
            assert traffic.number[slot] == newest.get(slot, 0)
            assert traffic.slot_frames[slot] == frames
            nominal, data = bits(8, Flags.FD | Flags.BRS)
            assert traffic.slot_bits[slot] == pytest.approx(frames * nominal)
            assert traffic.slot_data_bits[slot] == pytest.approx(frames * data)


def test_error_frames_are_counted_apart():
    traffic = TrafficStruct()
    traffic_add(traffic, Frame.of(4, bytes(8), int(Flags.ERROR)))
    assert (traffic.frames, traffic.error_frames, traffic.bits) == (0, 1, 0)
