"""Encoding of values against a bit-by-bit packer: limits, values between, values not finite."""

from __future__ import annotations

import math
import struct
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.codec import Codec
from bridge.can.codec_check import verify
from bridge.can.layout import CodecError, LayoutError, MessageLayout, Signal, find, stream
from bridge.native.frame import Flags
from bridge.native.message import Decoded, FieldKind, Header
from tests.bridge.can.layouts import LINKS, layout, layouts, placed

INTEGERS = st.sampled_from([FieldKind.SIGNED, FieldKind.UNSIGNED])


@st.composite
def signals(draw, length=64):
    """Any integer field that lies in `length` bytes, with a full range."""
    bits, motorola = draw(st.integers(1, 64)), draw(st.booleans())
    first = draw(st.integers(0, 8 * length - bits))  # in the order of its bytes
    start = 8 * (first // 8) + 7 - first % 8 if motorola else first
    return Signal("x", start, bits, draw(INTEGERS), motorola)


@given(signals(), st.data())
def test_any_field_is_written_and_read_bit_by_bit(signal, data):
    codec = Codec(MessageLayout("M", 1, 64, (signal,), Flags.FD))
    low, high = signal.raw_range
    value = float(data.draw(st.integers(low, high)))
    raw = min(max(int(value), low), high)  # 2^63 - 1 is no double
    found = codec.encode([value])
    assert found == placed(signal, raw, bytes(64))
    result, values, _ = codec.decode(found)
    assert (result, values[0]) == (Decoded.OK, float(raw))


@given(signals(8), st.binary(min_size=8, max_size=8), st.integers(0, 2**63 - 1))
def test_bits_beside_a_field_stay(signal, ground, raw):
    codec = Codec(MessageLayout("M", 1, 8, (signal,)))
    codec.message.fill[:8] = list(ground)
    low, high = signal.raw_range
    value = min(max(raw, low), high) // 2**11 * 2**11 if signal.length > 53 else raw % (high + 1)
    assert codec.encode([value]) == placed(signal, value, ground)


def test_motorola_and_intel_share_a_message():
    both = (
        Signal("a", 3, 12, motorola=True),
        Signal("b", 16, 9),
        Signal("c", 39, 20, motorola=True),
    )
    codec = Codec(MessageLayout("M", 1, 8, both))
    result, values, _ = codec.decode(codec.encode([-1234.0, 255.0, 524287.0]))
    assert result is Decoded.OK and values.tolist() == [-1234.0, 255.0, 524287.0]


@given(
    st.floats(-40, 40), st.sampled_from([2.0**-10, 0.01, 0.3, -0.25]), st.sampled_from([0.0, 5.0])
)
def test_rounded_to_the_nearest_and_saturated(value, scale, offset):
    signal = Signal("x", 0, 8, FieldKind.SIGNED, scale=scale, offset=offset, invalid=-128)
    codec = Codec(MessageLayout("M", 1, 1, (signal,)))
    raw = round((value - offset) / scale)  # Python rounds halves to even too
    header = Header()
    found = codec.frame([value], header).payload
    assert struct.unpack("b", found)[0] == min(max(raw, -127), 127)
    assert header.saturated == (not -127 <= raw <= 127)


@pytest.mark.parametrize("half", [-2.5, -1.5, -0.5, 0.5, 1.5, 2.5, 0.49999999999999994])
def test_halves_go_to_even(half):
    codec = Codec(MessageLayout("M", 1, 8, (Signal("x", 0, 64),)))
    assert codec.decode(codec.encode([half]))[1][0] == round(half)


@pytest.mark.parametrize("file", LINKS)
def test_zero_is_zero_and_invalid_is_invalid(file):
    for found in layouts(file):
        codec = Codec(found)
        zeros = np.zeros(len(codec.signals))
        assert codec.decode(codec.encode(zeros))[1].tolist() == zeros.tolist()
        for i, signal in enumerate(codec.signals):
            if signal.invalid is None:
                continue
            for no_number in (math.nan, math.inf, -math.inf):
                values = zeros.copy()
                values[i] = no_number
                result, decoded, header = codec.decode(codec.encode(values, status=0x90))
                assert result is Decoded.INVALID and np.isnan(decoded).all()
                assert header.status == 0x90


def test_without_an_invalid_code_no_number_is_what_is_nearest_to_zero():
    signals = (Signal("x", 0, 8), Signal("y", 8, 8, low=3), Signal("z", 16, 32, FieldKind.FLOAT))
    codec = Codec(MessageLayout("M", 1, 7, signals))
    for no_number in (math.nan, math.inf):
        header = Header()
        frame = codec.frame([no_number] * 3, header)
        assert codec.decode(frame.payload)[1].tolist() == [0.0, 3.0, 0.0]
        assert header.saturated == 3


def test_saturated_values_are_counted_by_message():
    codec, header = Codec(layout("link_fd2.dbc", "LINK_1")), Header()
    for values, count in (([1e9, -1e9, 0.0, 1e4], 3), ([0.0] * 4, 0)):
        codec.frame(values, header)
        assert header.saturated == count


def test_a_raw_value_outside_the_range_is_refused():
    codec = Codec(MessageLayout("M", 1, 1, (Signal("x", 0, 8, low=-100, high=100, invalid=-128),)))
    for raw in range(-128, 128):
        result = codec.decode(struct.pack("b", raw))[0]
        expected = Decoded.OK if abs(raw) <= 100 else Decoded.RANGE
        assert result is (Decoded.INVALID if raw == -128 else expected)
    assert codec.decode(b"")[0] is codec.decode(b"12")[0] is Decoded.LENGTH


@given(st.floats(width=64), st.floats(-1e39, 1e39), st.booleans())
def test_floats_of_32_and_64_bits(wide, narrow, limited):
    ends = {"low": -0.1, "high": 0.3} if limited else {}
    signals = (
        Signal("x", 3, 64, FieldKind.FLOAT, invalid=0),
        Signal("y", 71, 32, FieldKind.FLOAT, motorola=False, **ends),
    )
    codec = Codec(MessageLayout("M", 1, 16, signals, Flags.FD))
    result, values, _ = codec.decode(codec.encode([wide, narrow]))
    if not math.isfinite(wide):
        assert result is Decoded.INVALID
        return
    low, high = signals[1].raw_range
    assert result is Decoded.OK and values[0] == wide
    assert values[1] == np.float32(min(max(narrow, low), high))
    if limited:
        assert Fraction("-0.1") <= Fraction(low) and Fraction(high) <= Fraction("0.3")


@pytest.mark.parametrize(("bits", "form"), [(32, "<f"), (64, "<d")])
@pytest.mark.parametrize(
    ("value", "inside"),
    [(-0.5, True), (0.0, True), (0.25, True), (-0.5000001, False), (0.2500001, False),
     (-1e30, False), (1e30, False)],
)  # fmt: skip
def test_a_float_outside_its_range_is_saturated_by_its_sender_and_refused(
    bits, form, value, inside
):
    signal = Signal("x", 0, bits, FieldKind.FLOAT, motorola=False, low=-0.5, high=0.25)
    codec = Codec(MessageLayout("M", 1, bits // 8, (signal,)))
    assert codec.decode(struct.pack(form, value))[0] is (Decoded.OK if inside else Decoded.RANGE)
    header = Header()
    result, values, _ = codec.decode(codec.frame([value], header).payload)
    assert result is Decoded.OK and values[0] == min(max(value, -0.5), 0.25)
    assert header.saturated == (not inside)


def test_signals_that_carry_nothing_are_sent_as_they_start():
    rpdo = layout("drives.dbc", "CIA402_RPDO1_1")
    codec = Codec(rpdo, ["tau1"])
    assert codec.encode([1.0]).hex() == "0f000af401000000"  # enable operation, CST, 500 per mille
    assert codec.decode(codec.encode([1.0]))[1].tolist() == [1.0]


def test_the_order_of_values_is_chosen():
    fd = layout("link_fd2.dbc", "LINK_3")
    one, other = Codec(fd, ["xi2", "tau1"]), Codec(fd)
    data = one.encode([-3.0, 2.0])
    assert dict(zip([s.name for s in other.signals], other.decode(data)[1], strict=True)) == {
        "tau1": 2.0, "tau2": 0.0, "xi1": 0.0, "xi2": -3.0,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("signals", "complaint"),
    [
        (["tau1", "x11"], "has no signal 'x11'; did you mean xi1"),
        (["tau1", "tau1"], "tau1 is carried twice"),
        (["crc"], "has no signal 'crc'"),
    ],
)
def test_signals_that_cannot_be_carried(signals, complaint):
    with pytest.raises(LayoutError, match=complaint):
        Codec(layout("link_fd2.dbc", "LINK_1"), signals)


@pytest.mark.parametrize(
    ("signal", "complaint"),
    [
        (Signal("x", 60, 8), "bit 64 is outside the 8 bytes"),
        (Signal("x", 9, 16), "already used by other"),
        (Signal("x", 32, 16, FieldKind.FLOAT), "expected one of .32, 64."),
        (Signal("x", 32, 8, scale=0.0), "scale 0"),
        (Signal("x", 32, 8, low=200), "no value between"),
        (Signal("x", 32, 8, invalid=3), "invalid code 3"),
    ],
)
def test_layouts_that_cannot_be(signal, complaint):
    with pytest.raises(LayoutError, match=complaint):
        Codec(MessageLayout("M", 1, 8, (Signal("other", 8, 8), signal)))


def test_a_wrong_number_of_values_is_an_error():
    with pytest.raises(LayoutError, match=r"shape \(3,\); expected \(4,\)"):
        Codec(layout("link_fd2.dbc", "LINK_1")).encode([1, 2, 3])


def test_status_and_time_travel_as_far_as_they_fit():
    classic, fd = Codec(layout("link2.dbc", "TAU_1")), Codec(layout("link_fd2.dbc", "LINK_1"))
    for codec, bits, mask in ((classic, 16, 0xF0), (fd, 32, 0xFF)):
        zeros = np.zeros(len(codec.signals))
        header = codec.decode(codec.encode(zeros, 0xB5, 0xABCDE123, 0x1F2))[2]
        assert (header.status, header.t_us) == (0xB5 & mask, 0xABCDE123 % 2**bits)
        assert header.counter == (0x1F2 & (0xF if mask == 0xF0 else 0xFF))
        assert (codec.layout.status_mask, codec.layout.time_bits) == (mask, bits)


def test_stream_messages():
    codec = Codec(stream("ARM", 7, 0x12345678, ["q1", "q2", "dq1"]))
    values = [math.pi, -1e-300, 1e300]
    data = codec.encode(values, status=131, t_us=2**32 - 1, counter=0x10007)
    assert data[:8].hex() == "0030000712345678" and data[12] == 131
    assert data[24:] == struct.pack("<3d", *values)
    result, decoded, header = codec.decode(data)
    assert result is Decoded.OK and decoded.tolist() == values
    assert (header.counter, header.status, header.t_us) == (7, 131, 2**32 - 1)
    assert len(Codec(stream("ARM", 7, 1, [f"q{i}" for i in range(26)])).encode([0] * 26)) == 232
    with pytest.raises(LayoutError, match="232 fit"):
        stream("ARM", 7, 1, [f"q{i}" for i in range(27)])


@pytest.mark.parametrize("file", [*LINKS, "drives.dbc"])
def test_c_and_cantools_agree(file):
    seen = set()
    for found in layouts(file):
        if found.name.rsplit("_", 1)[0] not in seen:
            verify(Codec(found), 40)
        seen.add(found.name.rsplit("_", 1)[0])


@pytest.mark.parametrize("change", ["scale", "start", "length", "high", "data_ids", "fill"])
def test_verify_sees_a_table_that_differs(change):
    codec = Codec(layout("link_fd2.dbc", "LINK_2"))
    field = codec.message.fields[2]
    if change == "scale":
        field.scale *= 1 + 1e-9
    elif change in ("start", "length"):
        setattr(field, change, getattr(field, change) - 1)
    elif change == "high":
        field.high += 1 if field.high < 0 else -1
    elif change == "data_ids":
        codec.message.data_ids[0] ^= 1
    else:
        codec.message.fill[23] = 1
        codec.message.n_fields -= 1
    with pytest.raises(CodecError, match=r"link_fd2\.dbc: message LINK_2: "):
        verify(codec)


def test_find_names_what_is_near():
    with pytest.raises(LayoutError, match=r"no message 'LINK_11'; did you mean LINK_1 or"):
        find(layouts("link_fd.dbc"), "LINK_11")
