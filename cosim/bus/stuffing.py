"""Bit stuffing and CRC-15 of CAN as tables with one look-up per byte.

After five equal bits a bit of the other value is inserted, which counts as the first of the next
run. The state of a sender is the last value and the number of times it was sent in a row: ten
states, ``5 * value + run - 1``. A stuff bit is counted when the bit after it is sent, so that a
run of five at the end remains visible: after the CRC of a classic frame a stuff bit follows it,
before the CRC field of an FD frame only the fixed stuff bit.

Source: ISO 11898-1:2015, 10.5 (bit stuffing).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache

STATES = 10
#: Before a frame: recessive for long; the first bit is dominant, so that the run does not matter.
IDLE = 5
#: A stuff bit is due in these states.
DUE = (4, 9)


def step(state: int, bit: int) -> tuple[int, int]:
    """(state, stuff bits) after one more `bit`."""
    value, run = state // 5, state % 5 + 1
    stuffed = run == 5
    if stuffed:
        value, run = 1 - value, 1
    run = run + 1 if bit == value else 1
    return 5 * bit + run - 1, int(stuffed)


def walk(state: int, bits: Iterable[int]) -> tuple[int, int]:
    """(state, stuff bits) after `bits`, from `state`."""
    count = 0
    for bit in bits:
        state, stuffed = step(state, bit)
        count += stuffed
    return state, count


def bits_of(value: int, width: int) -> list[int]:
    """The `width` lowest bits of a value, most significant first: as they are sent."""
    return [value >> i & 1 for i in reversed(range(width))]


def table(width: int) -> tuple[int, ...]:
    """``table[state << width | value]`` = stuff bits << (width + 4) | next state << width."""
    entries = []
    for state in range(STATES):
        for value in range(1 << width):
            after, count = walk(state, bits_of(value, width))
            entries.append(count << (width + 4) | after << width)
    return tuple(entries)


def crc15(bits: Iterable[int], crc: int = 0) -> int:
    """CRC-15 of classic frames, polynomial 0x4599, most significant bit first."""
    for bit in bits:
        high = crc >> 14 ^ bit
        crc = crc << 1 & 0x7FFF ^ (0x4599 if high else 0)
    return crc


#: A byte further: ``CRC15[crc >> 7 ^ byte] ^ (crc << 8 & 0x7FFF)``.
CRC15 = tuple(crc15(bits_of(byte, 8)) for byte in range(256))
BYTE = table(8)
SEVEN = table(7)


def data_and_crc(state: int, crc: int, data: bytes) -> int:
    """Stuff bits in data and CRC of a classic frame, from where its header left off.

    The first one may be due by the header; the last one may stand before the CRC delimiter.
    """
    at, count = state << 8, 0
    for byte in data:
        entry = BYTE[at | byte]
        at = entry & 0xF00
        count += entry >> 12
        crc = CRC15[crc >> 7 ^ byte] ^ (crc << 8 & 0x7FFF)
    entry = BYTE[at | crc >> 7]
    last = SEVEN[(entry & 0xF00) >> 1 | crc & 0x7F]
    return count + (entry >> 12) + (last >> 11) + ((last >> 7 & 15) in DUE)


def data_only(state: int, data: bytes) -> int:
    """Dynamic stuff bits in the data of an FD frame, from where its header left off."""
    at, count = state << 8, 0
    for byte in data:
        entry = BYTE[at | byte]
        at = entry & 0xF00
        count += entry >> 12
    return count


@lru_cache(maxsize=4096)
def expected(pattern: Sequence[int | None]) -> tuple[float, float]:
    """(stuff bits expected, probability that one is due at the end) of a frame's bits.

    A bit that is None is 0 or 1 with probability 1/2 each, independent of the others.
    """
    chance = [0.0] * STATES
    chance[IDLE] = 1.0
    mean = 0.0
    for bit in pattern:
        following = [0.0] * STATES
        for state, p in enumerate(chance):
            for value in (0, 1) if bit is None else (bit,):
                share = p * (0.5 if bit is None else 1.0)
                after, count = step(state, value)
                following[after] += share
                mean += share * count
        chance = following
    return mean, sum(chance[state] for state in DUE)
