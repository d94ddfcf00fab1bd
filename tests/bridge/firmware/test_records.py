"""Records on a serial line: what is written is read, and damage is noticed."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.firmware import records
from bridge.firmware.records import FirmwareError, Hello, Kind, Reader, SlotDone, pack
from bridge.native.frame import Flags, Frame
from tests.bridge.export.records import frame_record, record

RECORDS = st.lists(st.tuples(st.sampled_from(Kind), st.binary(max_size=40)), max_size=6)
#: Bytes of a line between records, in which none begins.
NOISE = st.binary(max_size=20).map(lambda data: data.replace(b"\xc5", b"\x5c"))


def pieces(data, cuts):
    at = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(at)]


@given(RECORDS, st.lists(st.integers(0, 10_000), max_size=8))
def test_records_in_pieces_of_any_size_are_those_that_were_sent(sent, cuts):
    reader = Reader()
    data = b"".join(pack(kind, payload) for kind, payload in sent)
    assert data == b"".join(record(kind.value, payload) for kind, payload in sent)
    found = [one for piece in pieces(data, cuts) for one in reader.feed(piece)]
    assert found == sent
    assert (reader.damaged, reader.waiting) == (0, 0)


@given(st.lists(st.tuples(NOISE, st.sampled_from(Kind), st.binary(max_size=9)), max_size=6), NOISE)
def test_noise_between_records_is_skipped_and_counted(sent, last):
    reader = Reader()
    data = b"".join(noise + pack(kind, payload) for noise, kind, payload in sent) + last
    assert list(reader.feed(data)) == [(kind, payload) for _, kind, payload in sent]
    assert reader.damaged == sum(len(noise) for noise, _, _ in sent) + len(last)


@given(st.binary(max_size=30), st.data())
def test_a_record_with_a_flipped_bit_is_none(payload, data):
    """The reader finds a later record, at the latest after the length that was damaged."""
    whole = bytearray(pack(Kind.ROW, payload))
    bit = data.draw(st.integers(0, 8 * len(whole) - 1))
    whole[bit // 8] ^= 1 << bit % 8
    reader = Reader(longest=200)
    assert (Kind.ROW, payload) not in list(reader.feed(bytes(whole)))
    found = list(reader.feed(b"\0" * 210 + pack(Kind.DONE, b"later")))
    assert found[-1] == (Kind.DONE, b"later")
    assert reader.damaged > 0


def test_a_length_that_nothing_has_is_noise():
    reader = Reader(longest=100)
    head = bytes([records.MAGIC, ord("r")]) + (101).to_bytes(2, "little")
    assert list(reader.feed(head + pack(Kind.QUIT))) == [(Kind.QUIT, b"")]
    assert reader.damaged == len(head)


def test_the_crc_is_that_of_the_catalogue():
    """CRC-16/IBM-3740 of the catalogue of parametrised CRC algorithms: 0x29B1 for "123456789"."""
    assert records.crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_frames_go_both_ways_unchanged():
    frame = Frame.of(0x1ABCDEF, bytes(range(64)), Flags.FD | Flags.EXTENDED, 0)
    frame.bus = 1
    data = records.pack_frame(frame, 123456789)
    assert data == frame_record(1, frame.flags, frame.id, 123456789, bytes(range(64)))
    ((_, payload),) = Reader().feed(data)
    found = records.unpack_frame(payload)
    assert (found.bus, found.flags, found.id) == (1, frame.flags, frame.id)
    assert (found.t_ns, bytes(found.data[:64])) == (123456789, bytes(range(64)))


def test_hello_and_slots_go_both_ways():
    hello = Hello(1, 2, 328, 5_000_000, 500_000, 20, bytes(range(16)), "master_contröl")
    assert Hello.of(hello.payload()) == hello
    ((_, payload),) = Reader().feed(records.pack_slot(7, 35_500_000))
    assert records.unpack_slot(payload) == (7, 35_500_000)
    ((_, payload),) = Reader().feed(records.pack_done(SlotDone(7, -1, 3)))
    assert records.unpack_done(payload) == SlotDone(7, -1, 3)


@pytest.mark.parametrize(
    ("read", "payload", "text"),
    [
        (Hello.of, bytes(47), "a hello of 47 bytes; expected at least 48"),
        (records.unpack_frame, bytes(15), "a frame of 15 bytes; expected at least 16"),
        (records.unpack_frame, b"\0\0\x05" + bytes(13), "0 bytes of data; expected 5"),
        (records.unpack_frame, b"\0\0\xe9" + bytes(13 + 233), "233 bytes of data; expected 232"),
        (records.unpack_done, bytes(15), "a record with 15 bytes; expected 16"),
        (lambda data: pack(Kind.LOG, data), bytes(65536), "65536 bytes; expected 65535 at most"),
    ],
)
def test_payloads_of_another_size_are_refused(read, payload, text):
    with pytest.raises(FirmwareError, match=text):
        read(payload)
