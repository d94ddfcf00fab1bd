"""Records: the byte stream between this host and an image, over a serial line.

A record is ``0xC5``, its kind (1 byte), the length of its payload (uint16), the payload, and the
CRC-16 of kind, length and payload (polynomial 0x1021, initial value 0xFFFF); little endian. A
reader that finds something else skips to the next ``0xC5``, and counts the bytes that it skipped.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Self, final

from bridge.native.frame import DATA, Frame
from cosim.base.errors import RunError

MAGIC = 0xC5
#: Version of the records that this host speaks.
VERSION = 1
#: The longest payload, bytes.
LONGEST = 0xFFFF
#: Payloads of MODE: an image lives by its own clock, or slot by slot.
WALL, SLOTS = b"\0", b"\1"
_HEAD, _CRC = struct.Struct("<BBH"), struct.Struct("<H")
_FRAME, _HELLO = struct.Struct("<BBBBIq"), struct.Struct("<HHIqqq16s")
_SLOT, _DONE = struct.Struct("<qq"), struct.Struct("<qii")


class Kind(StrEnum):
    """The kinds of records, by their byte."""

    MODE = "m"
    FRAME = "f"
    SLOT = "s"
    TELL = "t"
    QUIT = "q"
    HELLO = "h"
    SAMPLE = "j"
    ROW = "r"
    DONE = "d"
    LOG = "l"


class FirmwareError(RunError):
    """An image or its emulator did not do what was expected of it."""


@dataclass(frozen=True, slots=True)
class Hello:
    """The answer to MODE: the node that an image is, as its deployment was when it was built.

    `row`: bytes of a row of the journal; `token`: 16 bytes, of the tables of the deployment.
    """

    version: int
    number: int
    row: int
    h_ns: int
    phase_ns: int
    slots: int
    token: bytes
    name: str

    def payload(self) -> bytes:
        """The payload of HELLO."""
        head = (self.version, self.number, self.row, self.h_ns, self.phase_ns, self.slots)
        return _HELLO.pack(*head, self.token) + self.name.encode()

    @classmethod
    def of(cls, payload: bytes) -> Self:
        """The payload of HELLO, read. Raises FirmwareError."""
        if len(payload) < _HELLO.size:
            text = f"a hello of {len(payload)} bytes; expected at least {_HELLO.size}"
            raise FirmwareError(text)
        version, number, row, h_ns, phase_ns, slots, token = _HELLO.unpack_from(payload)
        name = payload[_HELLO.size :].decode(errors="replace")
        return cls(version, number, row, h_ns, phase_ns, slots, token, name)


@dataclass(frozen=True, slots=True)
class SlotDone:
    """The end of a slot: its number, the `result` of its components (0: well), and how many rows of
    received samples an image had no room for.
    """

    slot: int
    result: int = 0
    dropped: int = 0


def pack(kind: Kind, payload: bytes = b"") -> bytes:
    """A record. Raises FirmwareError for a payload that is longer than `LONGEST`."""
    if len(payload) > LONGEST:
        raise FirmwareError(f"a record of {len(payload)} bytes; expected {LONGEST} at most")
    body = _HEAD.pack(MAGIC, ord(kind), len(payload)) + payload
    return body + _CRC.pack(crc_hqx(body[1:], 0xFFFF))


def pack_frame(frame: Frame, t_ns: int = 0) -> bytes:
    """A record of a frame: `t_ns` of its arrival, ns."""
    head = _FRAME.pack(frame.bus, frame.flags, frame.length, 0, frame.id, t_ns)
    return pack(Kind.FRAME, head + bytes(frame.data[: frame.length]))


def unpack_frame(payload: bytes) -> Frame:
    """The frame of a record. Raises FirmwareError for one of another size."""
    if len(payload) < _FRAME.size:
        raise FirmwareError(f"a frame of {len(payload)} bytes; expected at least {_FRAME.size}")
    bus, flags, length, _, number, t_ns = _FRAME.unpack_from(payload)
    data = payload[_FRAME.size :]
    if length != len(data) or length > DATA:
        expected = min(length, DATA)
        raise FirmwareError(f"a frame with {len(data)} bytes of data; expected {expected}")
    frame = Frame(t_ns=t_ns, id=number, flags=flags, bus=bus, length=length)
    frame.data[:length] = list(data)
    return frame


def pack_slot(slot: int, limit_ns: int) -> bytes:
    """The request to compute a slot with what has arrived by `limit_ns` (ns since t = 0)."""
    return pack(Kind.SLOT, _SLOT.pack(slot, limit_ns))


def unpack_slot(payload: bytes) -> tuple[int, int]:
    """The number of a requested slot, and its limit, ns. Raises FirmwareError."""
    slot, limit_ns = _unpacked(_SLOT, payload)
    return slot, limit_ns


def pack_done(done: SlotDone) -> bytes:
    """The end of the answer to SLOT."""
    return pack(Kind.DONE, _DONE.pack(done.slot, done.result, done.dropped))


def unpack_done(payload: bytes) -> SlotDone:
    """The end of the answer to SLOT. Raises FirmwareError for one of another size."""
    return SlotDone(*_unpacked(_DONE, payload))


def _unpacked(layout: struct.Struct, payload: bytes) -> tuple[int, ...]:
    if len(payload) != layout.size:
        text = f"a record with {len(payload)} bytes; expected {layout.size}"
        raise FirmwareError(text)
    return layout.unpack(payload)


@final
class Reader:
    """Records from bytes as they come, in pieces of any size.

    `longest`: the longest payload that is expected, bytes. `damaged`: bytes that were skipped;
    `waiting`: bytes of a record that is not complete.
    """

    def __init__(self, longest: int = LONGEST) -> None:
        self.damaged = 0
        self._longest = longest
        self._bytes = bytearray()

    @property
    def waiting(self) -> int:
        """Bytes of a record that is not complete."""
        return len(self._bytes)

    def feed(self, data: bytes) -> Iterator[tuple[Kind, bytes]]:
        """Add bytes; yield the kind and the payload of each record that they complete."""
        self._bytes += data
        while self._find():
            _, kind, length = _HEAD.unpack_from(self._bytes)
            end = _HEAD.size + length
            if len(self._bytes) < end + _CRC.size:
                return
            (crc,) = _CRC.unpack_from(self._bytes, end)
            if crc != crc_hqx(self._bytes[1:end], 0xFFFF):
                self._skip(1)
                continue
            payload = bytes(self._bytes[_HEAD.size : end])
            del self._bytes[: end + _CRC.size]
            yield Kind(chr(kind)), payload

    def _find(self) -> bool:
        """Skip to the next head of a record; True if it is complete."""
        while self._bytes:
            at = self._bytes.find(MAGIC)
            self._skip(len(self._bytes) if at < 0 else at)
            if len(self._bytes) < _HEAD.size:
                return False
            _, kind, length = _HEAD.unpack_from(self._bytes)
            if chr(kind) in _KINDS and length <= self._longest:
                return True
            self._skip(1)
        return False

    def _skip(self, count: int) -> None:
        self.damaged += count
        del self._bytes[:count]


_KINDS = frozenset(Kind)
