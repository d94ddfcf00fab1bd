"""The layout of a message as data, from a DBC file (:mod:`bridge.can.dbc`) or from a list."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction

from bridge.native.frame import DATA, Flags
from bridge.native.message import E2EProfile, FieldKind, header_bytes
from cosim.base.copies import replace
from cosim.base.errors import CosimError
from cosim.bus.timing import LONG


class LayoutError(CosimError, ValueError):
    """A message or a signal is not described, or is described as it cannot be."""


class CodecError(CosimError, RuntimeError):
    """Two codecs make different bytes of the same values, or different values of the same bytes."""


@dataclass(frozen=True)
class Signal:
    """A field: value = scale · raw + offset. `start` as in a DBC file (Motorola: the top bit)."""

    name: str
    start: int
    length: int
    kind: FieldKind = FieldKind.SIGNED
    motorola: bool = False
    scale: float = 1.0
    offset: float = 0.0
    low: float = -math.inf  # of the value; what the bits hold narrows it
    high: float = math.inf
    unit: str = ""
    initial: int = 0  # the raw bits of a signal that carries no value of ours
    invalid: int | None = None  # raw code of "no number"; FLOAT: any number stands for NaN

    @property
    def raw_range(self) -> tuple[int, int] | tuple[float, float]:
        """Least and greatest raw value, the invalid code left out."""
        ends = ((self.low - self.offset) / self.scale, (self.high - self.offset) / self.scale)
        low, high = min(ends), max(ends)
        if self.kind is FieldKind.FLOAT:
            return _float_range(low, high, self.length)
        least, most = _held(self.kind, self.length)
        if low == math.inf or high == -math.inf:  # an offset beyond all that the bits hold
            return most, least - 1
        first = least if low <= least else math.ceil(low - 1e-9 * max(1.0, abs(low)))
        last = most if high >= most else math.floor(high + 1e-9 * max(1.0, abs(high)))
        first, last = max(first, least), min(last, most)
        return first + (first == self.invalid), last - (last == self.invalid)

    def converted(self, gain: float, offset: float, unit: str) -> Signal:
        """The same bits as gain · value + offset, in `unit`."""
        low, high = sorted((gain * self.low + offset, gain * self.high + offset))
        scale, at = gain * self.scale, gain * self.offset + offset
        return replace(self, scale=scale, offset=at, low=low, high=high, unit=unit)

    def bits(self) -> list[int]:
        """Its bits in the data, least significant first; bit b of byte B is 8 B + b."""
        if not self.motorola:
            return list(range(self.start, self.start + self.length))
        top = 8 * (self.start // 8) + 7 - self.start % 8
        places = range(top + self.length - 1, top - 1, -1)
        return [8 * (place // 8) + 7 - place % 8 for place in places]


@dataclass(frozen=True)
class MessageLayout:
    """One message. `signals` may carry values; status, time, crc and counter are its header.

    `multiplexed`: names of signals that are in some of its frames only, and carry no values here.
    """

    name: str
    identifier: int
    length: int  # bytes
    signals: tuple[Signal, ...]
    flags: int = 0  # bridge.native.frame.Flags
    profile: E2EProfile = E2EProfile.NONE
    data_ids: bytes = bytes(16)
    status: Signal | None = None
    time: Signal | None = None
    crc: Signal | None = None
    counter: Signal | None = None
    period: float | None = None  # s, nominal (GenMsgCycleTime)
    source: str = ""  # the file it is from
    multiplexed: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """The place of its description, for messages."""
        return f"{self.source}: message {self.name}" if self.source else f"message {self.name}"

    @property
    def status_mask(self) -> int:
        """Bits of the status byte that travel: 0xFF, 0xF0 in classic frames, 0 without a status."""
        if self.status is None:
            return 0
        return int(self.status.scale) * ((1 << self.status.length) - 1) & 0xFF

    @property
    def time_bits(self) -> int:
        """Bits of the time stamp, 0 without one: it wraps after 2^time_bits us."""
        return self.time.length if self.time else 0

    def signal(self, name: str) -> Signal:
        """The signal of this name. Raises LayoutError with the nearest names."""
        for signal in self.signals:
            if signal.name == name:
                return signal
        if name in self.multiplexed:
            raise LayoutError(
                f"{self.place}: signal {name} is multiplexed; expected one that is in every frame"
            )
        raise LayoutError(
            f"{self.place} {_unknown('signal', name, [s.name for s in self.signals])}"
        )


def find(layouts: Iterable[MessageLayout], name: str) -> MessageLayout:
    """The layout of this name. Raises LayoutError with the nearest names."""
    known = {layout.name: layout for layout in layouts}
    if name in known:
        return known[name]
    source = next((layout.source for layout in known.values() if layout.source), "")
    raise LayoutError(f"{source}{': ' if source else ''}{_unknown('message', name, [*known])}")


def stream(name: str, number: int, data_id: int, signals: Sequence[str]) -> MessageLayout:
    """A message of a network without DBC files: Profile 4, then status, time stamp, float64s.

    Bytes: 0-11 header of the profile, 12 status, 13-15 zero, 16-19 t_us, 20-23 zero, 24.. the
    values; little endian after the header. Raises LayoutError for more than 26 signals.
    """
    length = 24 + 8 * len(signals)
    if length > DATA:
        raise LayoutError(f"message {name}: {len(signals)} signals take {length} bytes; {DATA} fit")
    values = tuple(
        Signal(signal, 192 + 64 * i, 64, FieldKind.FLOAT, invalid=0)
        for i, signal in enumerate(signals)
    )
    return MessageLayout(
        *(name, number, length, values),
        profile=E2EProfile.P04,
        data_ids=struct.pack("<I12x", data_id),
        status=Signal("status", 96, 8, FieldKind.UNSIGNED),
        time=Signal("t_us", 128, 32, FieldKind.UNSIGNED, unit="us"),
    )


#: Lengths of data, bytes, that frames of CAN FD can have.
FD_LENGTHS = (*range(9), *LONG)


def check(layout: MessageLayout) -> None:
    """Raise LayoutError for what the codec cannot do or a receiver could not tell apart."""
    if layout.flags & Flags.FD and layout.length not in FD_LENGTHS:
        raise LayoutError(
            f"{layout.place} has {layout.length} bytes; expected 0 to 8, "
            f"{', '.join(map(str, LONG[:-1]))} or {LONG[-1]}, as CAN FD has"
        )
    taken: dict[int, str] = dict.fromkeys(range(8 * header_bytes(layout.profile)), "")
    nibble = (
        range(12, 16) if layout.profile is E2EProfile.P02 else ()
    )  # the status, beside the counter
    taken = {bit: name for bit, name in taken.items() if bit not in nibble}
    header = [signal for signal in (layout.status, layout.time) if signal]
    for signal in (*header, *layout.signals):
        where = f"{layout.place}: signal {signal.name}"
        _check_signal(signal, where, header)
        for bit in signal.bits():
            if not 0 <= bit < 8 * layout.length:
                raise LayoutError(f"{where}: bit {bit} is outside the {layout.length} bytes")
            if bit in taken:
                raise LayoutError(
                    f"{where}: bit {bit} is already used by {taken[bit] or 'the E2E header'}"
                )
            taken[bit] = signal.name


def _check_signal(signal: Signal, where: str, header: list[Signal]) -> None:
    lengths = (32, 64) if signal.kind is FieldKind.FLOAT else range(1, 65)
    if signal.length not in lengths:
        raise LayoutError(f"{where}: {signal.length} bits; expected one of {lengths}")
    if signal.scale == 0 or not math.isfinite(signal.scale) or not math.isfinite(signal.offset):
        raise LayoutError(
            f"{where}: scale {signal.scale}, offset {signal.offset}; expected finite numbers "
            "and a scale other than 0"
        )
    if signal in header and (
        signal.kind is not FieldKind.UNSIGNED or signal.offset or signal.scale < 0
    ):
        raise LayoutError(f"{where}: status and time stamp must be unsigned and without offset")
    low, high = signal.raw_range
    if low > high:
        raise LayoutError(f"{where}: no value between {signal.low} and {signal.high} can be sent")
    if signal.invalid is not None and signal.kind is not FieldKind.FLOAT:
        least, most = _held(signal.kind, signal.length)
        if low <= signal.invalid <= high or not least <= signal.invalid <= most:
            raise LayoutError(
                f"{where}: invalid code {signal.invalid}; expected one of the raw values "
                f"{least} to {most} that no value has ({low} to {high} are values)"
            )


def _held(kind: FieldKind, length: int) -> tuple[int, int]:
    """The range that the bits hold; an unsigned field of 64 bits ends at 2^63 - 1."""
    if kind is FieldKind.SIGNED:
        return -(1 << length - 1), (1 << length - 1) - 1
    return 0, (1 << min(length, 63)) - 1


def _float_range(low: float, high: float, length: int) -> tuple[float, float]:
    """The range as doubles; of a float32 the outermost that are float32 themselves."""
    largest = (
        struct.unpack("<f", b"\xff\xff\x7f\x7f")[0] if length == 32 else 1.7976931348623157e308
    )
    low, high = max(low, -largest), min(high, largest)
    if length != 32 or low > high:  # no float32 at all lies in a range beyond them
        return low, high
    return -_single_below(-low), _single_below(high)


def _single_below(x: float) -> float:
    """The greatest float32 that is not above x."""
    found: float = struct.unpack("<f", struct.pack("<f", x))[0]
    if Fraction(found) <= Fraction(x):
        return found
    (bits,) = struct.unpack("<i", struct.pack("<f", found))
    step = -1 if found > 0 else 1
    below: float = struct.unpack("<f", struct.pack("<i", bits + step))[0]
    return below


def _unknown(noun: str, name: str, known: Sequence[str]) -> str:
    near = get_close_matches(name, known, n=3, cutoff=0.5)
    shown = " or ".join(near) if near else ", ".join(known[:8]) + (", ..." if known[8:] else "")
    return (
        f"has no {noun} {name!r}; " + ("did you mean " if near else "there are ") + (shown or "-")
    )
