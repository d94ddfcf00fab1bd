"""Bit times of frames: formulas, published numbers, and the bits themselves."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.bus.stuffing import IDLE, STATES, bits_of, step, walk
from cosim.bus.timing import (
    Bits,
    BusTiming,
    FrameFormat,
    TimingError,
    best,
    frame_bits,
    header,
    mean,
    padded,
    worst,
)
from tests.bridge.can import naive

FD = FrameFormat(fd=True, brs=True)
LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]
KINDS = [FrameFormat(extended=e) for e in (False, True)]
KINDS += [FrameFormat(extended=e, remote=True) for e in (False, True)]
KINDS += [
    FrameFormat(extended=e, fd=True, brs=b, esi=s) for e, b, s in product((False, True), repeat=3)
]
#: Runs of equal bits are what stuffing is about: bytes that have them, often.
BYTES = st.one_of(st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x83, 0x7C]), st.integers(0, 255))


@st.composite
def frames(draw: st.DrawFn) -> tuple[int, bytes, FrameFormat, int]:
    kind = draw(st.sampled_from(KINDS))
    top = (1 << (29 if kind.extended else 11)) - 1
    identifier = draw(st.one_of(st.sampled_from([0, top, 0x7C0 & top, 0x555]), st.integers(0, top)))
    length = draw(st.sampled_from(LENGTHS if kind.fd else LENGTHS[:9]))
    data = bytes(draw(st.lists(BYTES, min_size=length, max_size=length)))
    return identifier, b"" if kind.remote else data, kind, length


def by_hand(identifier: int, data: bytes, kind: FrameFormat, dlc: int) -> Bits:
    if not kind.fd:
        extended, remote = kind.extended, kind.remote
        return Bits(len(naive.classic(identifier, data, extended=extended, remote=remote, dlc=dlc)))
    phases = naive.flexible(identifier, data, extended=kind.extended, brs=kind.brs, esi=kind.esi)
    first, second, third = map(len, phases)
    return Bits(first + third, second) if kind.brs else Bits(first + second + third)


@given(frames())
def test_a_frame_has_the_bits_it_is_built_of(frame: tuple[int, bytes, FrameFormat, int]) -> None:
    identifier, data, kind, dlc = frame
    bits = frame_bits(identifier, data, kind, dlc)
    assert bits == by_hand(identifier, data, kind, dlc)
    low, high = best(dlc, kind), worst(dlc, kind)
    assert low.nominal <= bits.nominal <= high.nominal
    assert low.total <= bits.total <= high.total


@pytest.mark.parametrize("n", range(9))
def test_classic_frames_have_the_bits_of_the_formulas(n: int) -> None:
    assert best(n) == Bits(47 + 8 * n)
    assert worst(n) == Bits(55 + 10 * n)
    extended = FrameFormat(extended=True)
    assert best(n, extended) == Bits(67 + 8 * n)
    assert worst(n, extended) == Bits(80 + 10 * n)
    assert worst(n, FrameFormat(remote=True)) == worst(0)


def test_after_the_first_bit_every_fourth_can_be_stuffed() -> None:
    """Davis, 2007, figure 1: 1 1111 0000 1111 0000 ..."""
    assert most_stuffing([None] * 99) == (99 - 1) // 4
    assert walk(IDLE, [int(c) for c in "000001111000011110"]) == (1, 4)


def most_stuffing(pattern: list[int | None]) -> int:
    """The largest number of stuff bits that some choice of the free bits reaches."""
    reached = {IDLE: 0}
    for bit in pattern:
        following: dict[int, int] = {}
        for state, count in reached.items():
            for value in (0, 1) if bit is None else (bit,):
                after, more = step(state, value)
                following[after] = max(following.get(after, 0), count + more)
        reached = following
    return max(reached.values())


@pytest.mark.parametrize(
    ("n", "kind"), [(n, kind) for kind in KINDS for n in (LENGTHS if kind.fd else range(9))]
)
def test_the_worst_case_is_at_most_a_few_bits_above_what_can_be(n: int, kind: FrameFormat) -> None:
    free = 0 if kind.remote else 8 * n
    reached = most_stuffing([*header(None, n, kind), *[None] * (free + (0 if kind.fd else 15))])
    bound = worst(n, kind).total - best(n, kind).total
    assert 0 <= bound - reached <= 3


@pytest.mark.parametrize(
    ("n", "at_5m", "at_2m", "without"),
    [
        (8, 55.8, 123.0, 147),
        (16, 71.8, 163.0, 227),
        (24, 88.8, 205.5, 312),
        (32, 104.8, 245.5, 392),
        (48, 136.8, 325.5, 552),
        (64, 168.8, 405.5, 712),
    ],
)
def test_known_worst_cases_of_fd_frames(n: int, at_5m: float, at_2m: float, without: float) -> None:
    """us at 1 and 5 Mbit/s, at 500 kbit/s and 2 Mbit/s, and at 1 Mbit/s without BRS."""
    assert BusTiming(1e6, 5e6).time_ns(worst(n, FD)) == pytest.approx(at_5m * 1e3)
    assert BusTiming(5e5, 2e6).time_ns(worst(n, FD)) == pytest.approx(at_2m * 1e3)
    assert BusTiming(1e6, 5e6).time_ns(worst(n, FrameFormat(fd=True))) == without * 1e3


@pytest.mark.parametrize(
    ("n", "extended", "bits"),
    [(0, False, 62), (16, False, 62), (20, False, 67), (0, True, 81), (64, True, 86)],
)
def test_overhead_of_fd_frames_is_the_fields_of_the_standard(
    n: int, extended: bool, bits: int
) -> None:
    """SOF 1, identifier, RRS, IDE, FDF, res, BRS, ESI, DLC 4, count 4, CRC, 6 or 7, 1, 2, 7, 3."""
    assert best(n, FrameFormat(fd=True, extended=extended)).total - 8 * n == bits


@pytest.mark.parametrize(
    "kind", [FrameFormat(), FrameFormat(extended=True), FD, FrameFormat(fd=True, extended=True)]
)
def test_the_mean_is_that_of_random_frames(kind: FrameFormat) -> None:
    random = np.random.default_rng(1)
    n = 8
    ids = random.integers(0, 1 << (29 if kind.extended else 11), 4000)
    found = [frame_bits(int(i), random.bytes(n), kind) for i in ids]
    expected = mean(n, kind)
    for phase in (0, 1):
        values = np.array([bits[phase] for bits in found], float)
        assert values.mean() == pytest.approx(expected[phase], abs=0.15 + 1e-9)
    fixed = mean(n, kind, identifier=0x123)
    some = [frame_bits(0x123, random.bytes(n), kind).total for _ in range(4000)]
    assert np.mean(some) == pytest.approx(fixed.total, abs=0.15)


@pytest.mark.parametrize(
    ("frame", "bits"),
    [
        ("4FB#F0CB0FFF", 83),
        ("14C4664A#", 69),
        ("735#F0", 59),
        ("0F029D14#61", 77),
        ("0D0#00FFF00F00230FFF", 122),
        ("000E8A26#", 73),
        ("1AC#FF", 60),
        ("1BEAC3B0#F0", 79),
        ("7B1#FF", 58),
        ("05D03ACD#0F", 77),
        ("263#", 48),
        ("0B8EDE31#FF00F0D100F0F0F0", 136),
        ("000#", 53),
        ("000#0000000000000000", 127),
        ("7FF#FFFFFFFFFFFFFFFF", 126),
        ("00000000#0000000000000000", 150),
        ("1FFFFFFF#FFFFFFFFFFFFFFFF", 149),
    ],
)
def test_what_canbusload_counts(frame: str, bits: int) -> None:
    """``canbusload -e`` of can-utils, data frames: it counts data in remote ones, too."""
    identifier, data = frame.split("#")
    kind = FrameFormat(extended=len(identifier) == 8)
    assert frame_bits(int(identifier, 16), bytes.fromhex(data), kind) == Bits(bits)


def test_fd_frames_grow_to_the_next_length() -> None:
    assert [padded(n, True) for n in (8, 9, 13, 25, 33, 49, 64)] == [8, 12, 16, 32, 48, 64, 64]
    assert frame_bits(1, b"\xaa" * 9, FD) == frame_bits(1, b"\xaa" * 9 + bytes(3), FD)


def test_what_is_no_frame_is_refused() -> None:
    with pytest.raises(TimingError, match="found 9 bytes of data, expected 0 to 8"):
        frame_bits(1, bytes(9))
    with pytest.raises(TimingError, match="expected 0 to 64"):
        worst(65, FD)
    with pytest.raises(TimingError, match="0x800, expected 11 bits"):
        frame_bits(0x800, b"")
    with pytest.raises(TimingError, match="remote FD"):
        FrameFormat(fd=True, remote=True)
    with pytest.raises(TimingError, match="classic frame"):
        FrameFormat(brs=True)
    for rate in (0, -1, float("nan")):
        with pytest.raises(TimingError, match="bit/s"):
            BusTiming(rate)


def test_states_of_stuffing_are_ten() -> None:
    assert {step(s, b)[0] for s in range(STATES) for b in (0, 1)} <= set(range(STATES))
    assert bits_of(0b1011, 5) == [0, 1, 0, 1, 1]
