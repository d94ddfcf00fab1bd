"""Time that a frame occupies a CAN bus: exact from its bits, worst case, best case and mean.

Classic frames (CAN 2.0 A and B, data and remote) and CAN FD frames (ISO 11898-1:2015, with stuff
count), from start of frame to the end of the intermission of three bits:

====================  ==========================  ==================================
field                 11-bit identifier           29-bit identifier
====================  ==========================  ==================================
classic, stuffed      19 + 8 n + 15 (CRC)         39 + 8 n + 15 (CRC)
classic, tail         13: CRC delimiter, ACK, ACK delimiter, 7 end of frame, 3 intermission
FD, to BRS            17, nominal bit rate        36, nominal bit rate
FD, ESI to data       5 + 8 n, dynamic stuffing   5 + 8 n, dynamic stuffing
FD, CRC field         6 + 4 + 17 (n <= 16), 7 + 4 + 21: fixed stuff bits, stuff count, CRC
FD, tail              1 CRC delimiter; 12 nominal: ACK, ACK delimiter, end, intermission
====================  ==========================  ==================================

With BRS everything from ESI to the CRC delimiter has the data bit rate. Strictly, both switches of
the bit rate are at a sample point: BRS takes part of a nominal and part of a data bit, the CRC
delimiter the other parts. Together they are one nominal and one data bit for any sample points, so
the sum is exact.

A frame is received, and its sending confirmed, at the end of EOF: 3 nominal bits (the intermission)
before the end of the time given here.

Source: ISO 11898-1:2015 for the fields. Davis, Burns, Bril, Lukkien, Real-Time Systems 35 (2007),
eq. (1), for the worst case of classic frames: 55 + 10 n and 80 + 10 n bits.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

from cosim.base.errors import CosimError
from cosim.bus.stuffing import IDLE, bits_of, crc15, data_and_crc, data_only, expected, walk

#: Bits after the CRC of a classic frame, and in the nominal phase after that of an FD frame.
TAIL, FD_TAIL = 13, 12
#: Lengths that FD frames have beyond 8 bytes.
LONG = (12, 16, 20, 24, 32, 48, 64)


class TimingError(CosimError, ValueError):
    """No such frame, or no such bus."""


class Bits(NamedTuple):
    """Bit times of a frame at the nominal and at the data bit rate."""

    nominal: float
    data: float = 0

    @property
    def total(self) -> float:
        """The sum of both phases."""
        return self.nominal + self.data


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """The format of a frame, without identifier and data."""

    extended: bool = False
    fd: bool = False
    brs: bool = False
    remote: bool = False
    esi: bool = False
    flags: int = field(init=False, repr=False, compare=False)
    """``CAN_`` flags of ``cosim/c/bus/length.h``."""

    def __post_init__(self) -> None:
        given = (self.fd, self.brs, self.esi, self.remote, self.extended)
        flags = sum(bool(found) << place for place, found in enumerate(given))
        object.__setattr__(self, "flags", flags)
        if self.fd and self.remote:
            raise TimingError("found a remote FD frame; CAN FD has none")
        if not self.fd and (self.brs or self.esi):
            raise TimingError("found BRS or ESI in a classic frame; expected it in FD frames only")


CLASSIC = FrameFormat()


@dataclass(frozen=True, slots=True)
class BusTiming:
    """A bus: bit/s, in the data phase of FD frames `data_bitrate` (default: the same)."""

    bitrate: float
    data_bitrate: float | None = None
    fd: bool = False

    def __post_init__(self) -> None:
        for rate in (self.bitrate, self.data_bitrate):
            if rate is not None and not 0 < rate <= 1e9:
                raise TimingError(f"found a bit rate of {rate} bit/s, expected 1 to 1e9")

    def time_ns(self, bits: Bits) -> int:
        """The time of this number of bits, ns, rounded to the nearest.

        Do not add these up over a run: count bits, or ps as `cosim.bus.simulation` does.
        """
        data_rate = self.data_bitrate or self.bitrate
        return int(bits.nominal * 1e9 / self.bitrate + bits.data * 1e9 / data_rate + 0.5)

    @property
    def bit_ns(self) -> int:
        """A nominal bit, ns, to the nearest."""
        return self.time_ns(Bits(1))


def padded(length: int, fd: bool) -> int:
    """The length a frame has on the bus, bytes: FD frames grow to the next length there is.

    Raises TimingError for more than 8 (FD: 64) bytes.
    """
    if 0 <= length <= 8:
        return length
    if not fd or not 0 <= length <= 64:
        raise TimingError(f"found {length} bytes of data, expected 0 to {64 if fd else 8}")
    return next(n for n in LONG if n >= length)


def code(length: int) -> int:
    """DLC of a length on the bus."""
    return length if length <= 8 else 9 + LONG.index(length)


def header(identifier: int | None, length: int, kind: FrameFormat) -> list[int | None]:
    """Bits from start of frame to DLC; those of the identifier are None if it is not given.

    Raises TimingError if the identifier does not fit its 11 or 29 bits.
    """
    width = 29 if kind.extended else 11
    if identifier is not None and not 0 <= identifier < 1 << width:
        raise TimingError(f"found identifier {identifier:#x}, expected {width} bits")
    name: list[int | None] = [None] * width
    if identifier is not None:
        name = [*bits_of(identifier, width)]
    remote = int(kind.remote)
    bits: list[int | None] = [0, *name[:11]]
    bits += [1, 1, *name[11:], remote] if kind.extended else [remote, 0]
    if kind.fd:
        bits += [1, 0, int(kind.brs), int(kind.esi)]
    else:
        bits += [0, 0] if kind.extended else [0]
    return [*bits, *bits_of(code(length), 4)]


class HeaderState(NamedTuple):
    """The state after a frame's header: bits sent with stuffing, state of stuffing, CRC."""

    nominal: int
    data: int
    state: int
    crc: int


@lru_cache(maxsize=65536)
def start(identifier: int, length: int, kind: FrameFormat) -> HeaderState:
    """A frame's header, sent. `length`: on the bus."""
    bits = [int(bit or 0) for bit in header(identifier, length, kind)]
    split = len(bits) - 5 if kind.fd else len(bits)
    state, stuffed = walk(IDLE, bits[:split])
    after, late = walk(state, bits[split:])
    return HeaderState(split + stuffed, len(bits) - split + late, after, crc15(bits))


def frame_bits(identifier: int, data: bytes, kind: FrameFormat = CLASSIC, dlc: int = 0) -> Bits:
    """Exact bit times of a frame. `dlc`: what a remote frame asks for, bytes.

    FD frames of a length there is none of are filled with zeros to the next, as Linux does.
    """
    length = padded(dlc if kind.remote else len(data), kind.fd)
    begun = start(identifier, length, kind)
    if not kind.fd:
        stuffed = data_and_crc(begun.state, begun.crc, b"" if kind.remote else data)
        return Bits(begun.nominal + stuffed + _body(length, kind) + TAIL)
    stuffed = data_only(begun.state, data.ljust(length, b"\0"))
    return _phases(begun.nominal, begun.data + stuffed + _body(length, kind) + 1, kind)


def worst(length: int, kind: FrameFormat = CLASSIC) -> Bits:
    """A bound over all identifiers and data: a stuff bit for the first five bits, and each four.

    The nominal phase of FD frames gets as many of them as it could have.
    """
    length = padded(length, kind.fd)
    stuffable = len(header(None, length, kind))
    if not kind.fd:
        stuffable += _body(length, kind)
        return Bits(stuffable + (stuffable - 1) // 4 + TAIL)
    early, dynamic = (stuffable - 6) // 4, (stuffable + 8 * length - 2) // 4
    body = 5 + dynamic - early + _body(length, kind) + 1
    return _phases(stuffable - 5 + early, body, kind)


def best(length: int, kind: FrameFormat = CLASSIC) -> Bits:
    """A bound from below: no stuff bits but the fixed ones of FD frames."""
    length = padded(length, kind.fd)
    bits = len(header(None, length, kind))
    if not kind.fd:
        return Bits(bits + _body(length, kind) + TAIL)
    return _phases(bits - 5, 5 + _body(length, kind) + 1, kind)


def mean(length: int, kind: FrameFormat = CLASSIC, identifier: int | None = None) -> Bits:
    """Expected bit times for uniformly random data, and a random identifier if none is given.

    The CRC of a classic frame is taken as random, too; stuff bits are then a Markov chain.
    """
    length = padded(length, kind.fd)
    bits = header(identifier, length, kind)
    least = best(length, kind)
    if not kind.fd:
        stuffed, due = expected((*bits, *[None] * _body(length, kind)))
        return Bits(least.nominal + stuffed + due)
    early, _ = expected(tuple(bits[:-5]))
    all_, _ = expected((*bits, *[None] * (8 * length)))
    if not kind.brs:
        return Bits(least.nominal + all_)
    return Bits(least.nominal + early, least.data + all_ - early)


def _body(length: int, kind: FrameFormat) -> int:
    """Bits of data and CRC field, without dynamic stuffing."""
    if kind.fd:
        return 8 * length + (27 if length <= 16 else 32)
    return (0 if kind.remote else 8 * length) + 15


def _phases(before: float, within: float, kind: FrameFormat) -> Bits:
    if kind.brs:
        return Bits(before + FD_TAIL, within)
    return Bits(before + within + FD_TAIL)
