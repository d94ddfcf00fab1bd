"""End-to-end protection: the same bits as two other implementations, and what it detects."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from cantools.autosar import end_to_end as cantools
from e2e import crc as autosar_crc
from e2e import p02, p04, p05
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.codec import Codec
from bridge.can.layout import stream
from bridge.native.message import Decoded, E2EProfile, check, counter_bits, protect
from tests.bridge.can.layouts import LINKS, layout, layouts

IDS = bytes(range(16, 0, -1))
LIMITS = {E2EProfile.P02: 2, E2EProfile.P05: 3, E2EProfile.P04: 12}
PROFILES = sorted(LIMITS)

# (profile, data IDs, counter, data) -> what autosar-e2e 1.0.0 and cantools 45.1.0 (not P04) made of
# them, from seeded random bytes.
GOLDEN = [
    (2, "fdf3a80e4b5c5ce04ccb74821aae7bf0", 15,
     "9d9d754e53bde844",
     "2a9f754e53bde844"),
    (2, "75d5e01c838cb22c69129a921c1ca293", 2,
     "d6d55799492186e1",
     "f9d25799492186e1"),
    (2, "6ee07cb4c82aaacbc87896dbbae7b705", 5,
     "7975398333",
     "9175398333"),
    (5, "9ec80000000000000000000000000000", 184,
     "be7cbc6b5d042e3e5f87919b674efca319d1f2d1b8176bd0",
     "e770b86b5d042e3e5f87919b674efca319d1f2d1b8176bd0"),
    (5, "249f0000000000000000000000000000", 34,
     "62d2c2554a5b6af1613f83235fe4d483c9f044b83c855f895fd70f35534f61419ebf28ef6d921695293a1d58de7eb6b98c0da1b88a7e8fa6a7b1aa52391bb583",
     "8ebd22554a5b6af1613f83235fe4d483c9f044b83c855f895fd70f35534f61419ebf28ef6d921695293a1d58de7eb6b98c0da1b88a7e8fa6a7b1aa52391bb583"),
    (5, "37ad0000000000000000000000000000", 184,
     "a9d60559",
     "c8c8b859"),
    (4, "f54889a4000000000000000000000000", 50749,
     "f49913a1133b19fcf70bc6656c11a437",
     "0010c63da48948f56228aa206c11a437"),
    (4, "f8391699000000000000000000000000", 10050,
     "f6ac414fa59d507fb48932a9a57e1107ec27bbfe8f3f903a5f36baf11a1ea85062272c834fe2b08d1dc27f806a9c7896",
     "00302742991639f85f048bc2a57e1107ec27bbfe8f3f903a5f36baf11a1ea85062272c834fe2b08d1dc27f806a9c7896"),
]  # fmt: skip


def test_check_values_of_the_specification():
    """The CRC of "123456789" in AUTOSAR FO "Specification of CRC Routines"."""
    assert autosar_crc.calculate_crc8_h2f(b"123456789") == 0xDF  # the oracle means the same
    one = protect(E2EProfile.P02, b"9" * 16, 0, b"\0\x30" + b"2345678")
    assert one[1] == 0x30  # counter 0 beside the upper bits of byte 1
    assert protect(E2EProfile.P02, b"9" * 16, 1, b"\0\x30" + b"2345678")[0] == 0xDF
    two = protect(E2EProfile.P05, b"89" + bytes(14), ord("1"), b"\0\0\0" + b"234567")
    assert two[:2] == (0x29B1).to_bytes(2, "little")


@pytest.mark.parametrize(("profile", "ids", "counter", "data", "expected"), GOLDEN)
def test_golden_vectors(profile, ids, counter, data, expected):
    made = protect(E2EProfile(profile), bytes.fromhex(ids), counter, bytes.fromhex(data))
    assert made.hex() == expected
    assert check(E2EProfile(profile), bytes.fromhex(ids), made) == (Decoded.OK, counter)


def others(profile: E2EProfile, ids: bytes, counter: int, data: bytes) -> bytes:
    """What autosar-e2e makes."""
    out = bytearray(data)
    if profile is E2EProfile.P02:
        out[1] = out[1] & 0xF0 | counter
        p02.e2e_p02_protect(out, ids, increment_counter=False)
    elif profile is E2EProfile.P05:
        out[2] = counter
        number = int.from_bytes(ids[:2], "little")
        p05.e2e_p05_protect(out, number, increment_counter=False)
    else:
        out[2:4] = counter.to_bytes(2, "big")
        number = int.from_bytes(ids[:4], "little")
        p04.e2e_p04_protect(out, number, increment_counter=False)
    return bytes(out)


@pytest.mark.parametrize("profile", PROFILES)
@given(st.data())
def test_the_same_as_autosar_e2e_and_cantools(profile, data):
    ids = data.draw(st.binary(min_size=16, max_size=16))
    counter = data.draw(st.integers(0, 2 ** counter_bits(profile) - 1))
    text = data.draw(st.binary(min_size=max(4, LIMITS[profile]), max_size=232))
    made = protect(profile, ids, counter, text)
    assert made == others(profile, ids, counter, text)
    assert check(profile, ids, made) == (Decoded.OK, counter)
    if profile is E2EProfile.P02:
        assert made == cantools.apply_profile2_crc(made, ids[counter])
    elif profile is E2EProfile.P05:
        assert made == cantools.apply_profile5_crc(made, int.from_bytes(ids[:2], "little"))


@pytest.mark.parametrize("profile", PROFILES)
def test_short_and_foreign_messages(profile):
    made = protect(profile, IDS, 3, bytes(24))
    for length in range(LIMITS[profile]):
        assert check(profile, IDS, made[:length])[0] is Decoded.LENGTH
    for length in range(LIMITS[profile], 24):
        assert check(profile, IDS, made[:length])[0] is not Decoded.OK
    other = bytes(16) if profile is E2EProfile.P02 else bytes([IDS[0] ^ 1]) + IDS[1:]
    assert check(profile, other, made)[0] is Decoded.CRC


def test_a_message_of_another_node_is_not_taken_for_ours():
    for file in LINKS:
        protected = [x for x in layouts(file) if x.profile]
        data = {x.name: Codec(x).encode(np.zeros(len(x.signals)), counter=9) for x in protected}
        for one in protected[:12]:
            codec = Codec(one)
            for name, sent in data.items():
                if len(sent) == one.length:
                    assert (codec.decode(sent)[0] is Decoded.CRC) == (name != one.name)


def flipped(data: bytes, bits: tuple[int, ...]) -> bytes:
    out = bytearray(data)
    for bit in bits:
        out[bit // 8] ^= 1 << bit % 8
    return bytes(out)


def syndromes(profile: E2EProfile, ids: bytes, length: int, counter: int) -> np.ndarray:
    """What each wrong bit alone changes in the CRC that a receiver computes, and reads. A CRC is
    linear, and so are our lists of data IDs: of more bits it is the sum."""
    made = protect(profile, ids, counter, bytes(length))
    width = 1 if profile is E2EProfile.P02 else 2
    found = []
    for bit in range(8 * length):
        data = flipped(made, (bit,))
        again = protect(profile, ids, check_counter(profile, data), data)
        pairs = (int.from_bytes(x[:width], "little") for x in (data, again))
        found.append(next(pairs) ^ next(pairs))
    return np.array(found)


def check_counter(profile: E2EProfile, data: bytes) -> int:
    return data[1] & 15 if profile is E2EProfile.P02 else data[2]


@pytest.mark.parametrize(
    ("file", "message"),
    [("link.dbc", "TAU_A_1"), ("link.dbc", "VEL_C_8"), ("link.dbc", "HEARTBEAT_5"),
     ("link_fd2.dbc", "LINK_1"), ("link_fd.dbc", "STATE_4")],
)  # fmt: skip
def test_every_three_wrong_bits_are_detected(file, message):
    """All of them: no one, two or three syndromes sum to zero, whatever the counter."""
    found = layout(file, message)
    counters = range(16) if found.profile is E2EProfile.P02 else (0, 200)
    for counter in counters:
        single = syndromes(found.profile, found.data_ids, found.length, counter)
        assert 0 not in single and len(set(single.tolist())) == len(single)
        pairs = single[:, None] ^ single[None, :]
        assert not np.isin(pairs[np.triu_indices(len(single), 1)], single).any()


@pytest.mark.parametrize("name", ["XI_B_2", "HEARTBEAT_1"])
def test_three_wrong_bits_counter_included_by_trying(name):
    """That the lists are linear is not believed, but tried: bits of header and of one more byte."""
    codec = Codec(layout("link.dbc", name))
    for counter in (0, 5, 15):
        made = codec.encode(np.zeros(len(codec.signals)), counter=counter)
        for count in (1, 2, 3):
            for bits in combinations((*range(16), 17, 40, 63), count):
                assert codec.decode(flipped(made, bits))[0] is Decoded.CRC


@given(st.data())
def test_wrong_bits_anywhere(data):
    file, name = data.draw(
        st.sampled_from([("link2.dbc", "TAU_1"), ("link_fd.dbc", "LINK_1"), ("", "STREAM")])
    )
    found = layout(file, name) if file else stream(name, 1, 77, ["q1", "q2", "q3"])
    codec = Codec(found)
    values = data.draw(st.lists(st.floats(-4, 4), min_size=len(codec.signals)))
    made = codec.encode(values[: len(codec.signals)], 2, 3, data.draw(st.integers(0, 2**16)))
    bit = st.integers(0, 8 * found.length - 1)
    bits = data.draw(st.lists(bit, min_size=1, max_size=3, unique=True))
    result, decoded, _ = codec.decode(flipped(made, tuple(bits)))
    assert result in (Decoded.CRC, Decoded.LENGTH)
    assert np.isnan(decoded).all()
    start = data.draw(st.integers(0, 8 * found.length - 1))  # a burst no longer than the CRC
    width = {E2EProfile.P02: 8, E2EProfile.P05: 16, E2EProfile.P04: 32}[found.profile]
    body = LIMITS[found.profile] * 8
    if start >= body:
        burst = tuple(b for b in range(start, min(start + width, 8 * found.length)))
        assert codec.decode(flipped(made, burst))[0] is Decoded.CRC
