"""Operations of FMI-LS-BUS: the byte layouts of the standard, round trips, and bad bytes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.lsbus.codec import FD_LENGTHS, Malformed, decode, encode, split
from cosim.lsbus.operations import (
    ArbitrationLost,
    BusErrorCode,
    BusErrorFlag,
    BusFault,
    CanFdTransmit,
    CanTransmit,
    Configuration,
    ConfigurationParameter,
    Confirm,
    FormatError,
    LostArbitration,
    LsBusError,
    NodeStatus,
    StatusReport,
    Wakeup,
)

#: Written by hand from the tables of the standard: code, length, fields in their order.
LAYOUTS = [
    (FormatError(b"\x99"), "01000000 0b000000 0100 99"),
    (CanTransmit(0x123, data=b"\x01\x02"), "10000000 12000000 23010000 00 00 0200 0102"),
    (CanTransmit(0x18DAF110, True, True, bytes(3)),
     "10000000 13000000 10f1da18 01 01 0300 000000"),
    (CanFdTransmit(0x7FF, False, True, True, b"\xaa"),
     "11000000 12000000 ff070000 00 01 01 0100 aa"),
    (CanFdTransmit(1, True, False, True), "11000000 11000000 01000000 01 00 01 0000"),
    (Confirm(0x123), "20000000 0c000000 23010000"),
    (ArbitrationLost(0x123), "30000000 0c000000 23010000"),
    (BusFault(0x123, BusErrorCode.CRC, BusErrorFlag.SECONDARY, True),
     "31000000 0f000000 23010000 04 02 01"),
    (Configuration(ConfigurationParameter.CAN_BAUDRATE, 500_000),
     "40000000 0d000000 01 20a10700"),
    (Configuration(ConfigurationParameter.CAN_FD_BAUDRATE, 2_000_000),
     "40000000 0d000000 02 80841e00"),
    (Configuration(ConfigurationParameter.ARBITRATION_LOST_BEHAVIOR,
                   LostArbitration.DISCARD_AND_NOTIFY), "40000000 0a000000 04 02"),
    (StatusReport(NodeStatus.BUS_OFF), "41000000 09000000 03"),
    (Wakeup(), "42000000 08000000"),
]  # fmt: skip


@pytest.mark.parametrize(("operation", "layout"), LAYOUTS)
def test_bytes_are_those_of_the_standard(operation, layout: str) -> None:
    assert encode([operation]).hex() == layout.replace(" ", "")
    assert decode(bytes.fromhex(layout)) == [operation]


def identifiers() -> st.SearchStrategy[tuple[int, bool]]:
    wide = st.tuples(st.integers(0, (1 << 29) - 1), st.just(True))
    return st.one_of(st.tuples(st.integers(0, 0x7FF), st.just(False)), wide)


@st.composite
def transmits(draw: st.DrawFn):
    identifier, extended = draw(identifiers())
    if draw(st.booleans()):
        data = draw(st.binary(max_size=8))
        return CanTransmit(identifier, extended, draw(st.booleans()), data)
    length = draw(st.sampled_from(FD_LENGTHS))
    data = draw(st.binary(min_size=length, max_size=length))
    return CanFdTransmit(identifier, extended, draw(st.booleans()), draw(st.booleans()), data)


NUMBERS = st.integers(0, (1 << 29) - 1)
RATES = st.sampled_from(list(ConfigurationParameter)[:3])
ANY = st.one_of(
    transmits(),
    st.builds(FormatError, st.binary(max_size=40)),
    st.builds(Confirm, NUMBERS),
    st.builds(ArbitrationLost, NUMBERS),
    st.builds(
        BusFault,
        NUMBERS,
        st.sampled_from(BusErrorCode),
        st.sampled_from(BusErrorFlag),
        st.booleans(),
    ),
    st.builds(Configuration, RATES, st.integers(1, (1 << 32) - 1)),
    st.builds(StatusReport, st.sampled_from(NodeStatus)),
    st.just(Wakeup()),
)


@given(st.lists(ANY, max_size=6))
def test_what_was_encoded_is_decoded(operations) -> None:
    assert decode(encode(operations)) == operations


@given(st.lists(ANY, max_size=4), st.integers(0, 200), st.binary(max_size=4))
def test_damaged_bytes_are_refused_or_other_operations(operations, at: int, put: bytes) -> None:
    """Nothing but LsBusError comes out, no byte is lost, and what is accepted encodes to itself."""
    raw = encode(operations)
    damaged = raw[:at] + put + raw[at + len(put) :]
    parts = [x.raw if isinstance(x, Malformed) else encode([x]) for x in split(damaged)]
    assert b"".join(parts) == damaged


@given(st.binary(max_size=64))
def test_arbitrary_bytes_raise_nothing_else(raw: bytes) -> None:
    try:
        assert encode(decode(raw)) == raw
    except LsBusError as error:
        assert "found" in str(error) and "expected" in str(error)


@given(ANY)
def test_every_truncation_is_refused(operation) -> None:
    raw = encode([operation])
    for length in range(1, len(raw)):
        with pytest.raises(LsBusError, match="expected"):
            decode(raw[:length])


HEAD = struct.Struct("<II")


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b"\x10\0\0", "found 3 bytes at byte 0, expected a header of 8 bytes"),
        (HEAD.pack(0x42, 7), "length 7 at byte 0, expected 8 to 8 bytes"),
        (HEAD.pack(0x42, 1 << 31), "length 2147483648 at byte 0, expected 8 to 8"),
        (HEAD.pack(0x77, 8), "found code 0x77, expected one of the codes 0x01, 0x10"),
        (HEAD.pack(0x12, 8), "found CAN XL Transmit, which is not simulated"),
        (HEAD.pack(0x10, 17) + struct.pack("<IBBH", 1, 0, 0, 0) + b"x",
         "CAN Transmit of 17 bytes with 0 bytes of data, expected 16 bytes"),
        (HEAD.pack(0x10, 25) + struct.pack("<IBBH", 1, 0, 0, 9) + bytes(9),
         "CAN Transmit with 9 bytes of data, expected 0 to 8"),
        (HEAD.pack(0x10, 16) + struct.pack("<IBBH", 0x800, 0, 0, 0),
         "found identifier 0x800, expected 11 bits"),
        (HEAD.pack(0x10, 16) + struct.pack("<IBBH", 1 << 29, 1, 0, 0),
         "found identifier 0x20000000, expected 29 bits"),
        (HEAD.pack(0x10, 16) + struct.pack("<IBBH", 1, 2, 0, 0), "found IDE = 2, expected 0 or 1"),
        (HEAD.pack(0x11, 26) + struct.pack("<IBBBH", 1, 0, 0, 0, 9) + bytes(9),
         "CAN FD Transmit with 9 bytes of data, expected 0 to 7, 8, 12, 16"),
        (HEAD.pack(0x20, 13) + bytes(5), "found Confirm of 13 bytes, expected 12"),
        (HEAD.pack(0x31, 15) + bytes(4) + b"\7\1\0", "error code 7, expected 1 BIT, 2 STUFF"),
        (HEAD.pack(0x40, 13) + b"\1" + bytes(4), "found CAN_BAUDRATE 0, expected 1 bit/s or more"),
        (HEAD.pack(0x40, 10) + b"\5\0", "found parameter 5, expected 1 CAN_BAUDRATE"),
        (HEAD.pack(0x41, 9) + b"\0", "found status 0, expected 1 ERROR_ACTIVE"),
        (encode([Wakeup()]) + HEAD.pack(0x42, 9) + b"x", "operation at byte 8: found Wake-up of 9"),
    ],
)  # fmt: skip
def test_absurd_operations_are_refused_with_a_sentence(raw: bytes, reason: str) -> None:
    with pytest.raises(LsBusError, match="ecu1: ") as caught:
        decode(raw, "ecu1")
    assert reason in str(caught.value)


def test_good_operations_around_a_bad_one_are_kept() -> None:
    bad = HEAD.pack(0x77, 9) + b"x"
    found = split(encode([Wakeup()]) + bad + encode([Confirm(1)]))
    assert found[0] == Wakeup() and found[2] == Confirm(1)
    assert isinstance(found[1], Malformed) and found[1].raw == bad


@pytest.mark.parametrize(
    "operation",
    [
        CanTransmit(0x800), CanTransmit(1 << 32, True), CanTransmit(1, data=bytes(9)),
        CanFdTransmit(1, data=bytes(9)), FormatError(bytes(1 << 16)),
        Configuration(ConfigurationParameter.CAN_BAUDRATE, -1),
    ],
)  # fmt: skip
def test_values_that_do_not_fit_are_not_encoded(operation) -> None:
    with pytest.raises(LsBusError, match=r"found .*expected"):
        encode([operation])
