"""``message.h``, ``e2e.h``, ``receiver.h``, ``limit.h``: tables of fields, encoding, protection,
counters, as ctypes sees them.
"""

from __future__ import annotations

import ctypes as c
from enum import IntEnum
from functools import lru_cache
from typing import Any

from bridge.native.frame import Frame
from bridge.native.library import library
from bridge.native.safety import LifeState, Status

#: The most values a message may have.
FIELDS = 256


class FieldKind(IntEnum):
    """``FIELD_``: how the bits of a field are read."""

    UNSIGNED = 0
    SIGNED = 1
    FLOAT = 2


class E2EProfile(IntEnum):
    """``E2E_``: the AUTOSAR profile that protects a message."""

    NONE = 0
    P02 = 2
    P04 = 4
    P05 = 5

    @property
    def counter_bits(self) -> int:
        """Bits of its counter."""
        return {E2EProfile.NONE: 0, E2EProfile.P02: 4, E2EProfile.P04: 16, E2EProfile.P05: 8}[self]

    @property
    def header(self) -> int:
        """Bytes it needs at the start of the data."""
        return {E2EProfile.NONE: 0, E2EProfile.P02: 2, E2EProfile.P04: 12, E2EProfile.P05: 3}[self]


class Decoded(IntEnum):
    """``DECODE_``: what became of a received message."""

    OK = 0
    LENGTH = 1
    CRC = 2
    INVALID = 3
    RANGE = 4


class Rejection(IntEnum):
    """``RECEIVE_``: why a counter was not accepted."""

    REPEATED = -1
    OLDER = -2
    WRONG = -3


#: Turns of a short time stamp among which the counter decides.
STAMP_TURNS = 64
#: How far ahead of its time a sample is believed, ns, if its period is less.
EARLY_NS = 2_000_000
#: What a receiver counts, in the order of ``receiver_t``.
COUNTERS = (
    *("ok", "lost", "repeated", "reordered", "wrong_sequence", "crc", "length", "invalid"),
    *("range", "simulated", "stale", "rate", "resyncs"),
)
#: Those of frames that came and were refused.
REFUSALS = ("crc", "length", "invalid", "range", "rate", "simulated", "stale", "wrong_sequence")


class Field(c.Structure):
    """``field_t``."""

    _fields_ = (
        ("start", c.c_uint16),
        ("length", c.c_uint8),
        ("motorola", c.c_uint8),
        ("kind", c.c_uint8),
        ("has_invalid", c.c_uint8),
        ("reserved", c.c_uint16),
        ("scale", c.c_double),
        ("offset", c.c_double),
        ("low", c.c_int64),
        ("high", c.c_int64),
        ("invalid", c.c_int64),
    )


class Message(c.Structure):
    """``message_t``."""

    _fields_ = (
        ("id", c.c_uint32),
        ("length", c.c_uint16),
        ("flags", c.c_uint8),
        ("e2e", c.c_uint8),
        ("data_ids", c.c_uint8 * 16),
        ("n_fields", c.c_int32),
        ("status", c.c_int32),
        ("time", c.c_int32),
        ("exact", c.c_int32),
        ("fields", c.POINTER(Field)),
        ("header", c.POINTER(Field)),
        ("fill", c.c_uint8 * 64),
    )

    @property
    def carries_state(self) -> bool:
        """Whether its status contains the state of the sender; 4 bits (classic CAN) do not."""
        return bool(self.status >= 0 and self.header[self.status].scale == 1.0)

    def is_preview(self, status: int) -> bool:
        """Whether this status byte is from a configured sender that waits for its start.

        Such a frame contains the values with which its sender will start. It is not a sample of a
        run, and receivers do not count it.
        """
        waiting = (int(LifeState.UNCONFIGURED), int(LifeState.INACTIVE))
        return self.carries_state and status & int(Status.LIFE) in waiting


class Header(c.Structure):
    """``header_t``: counter, status byte, time stamp in us; how many values did not fit."""

    _fields_ = (
        ("counter", c.c_uint32),
        ("status", c.c_uint32),
        ("t_us", c.c_uint32),
        ("saturated", c.c_uint32),
    )


class Limit(c.Structure):
    """``limit_t``: what a received value may be."""

    _fields_ = (
        ("low", c.c_double),
        ("high", c.c_double),
        ("rate", c.c_double),
        ("falls", c.c_int64),
    )


class Receiver(c.Structure):
    """``receiver_t``: make it with :func:`receiver`."""

    _fields_ = (
        *((name, c.c_int64) for name in COUNTERS),
        *((name, c.c_int64) for name in ("sequence", "arrival_ns", "period_ns", "offset_ns")),
        ("counter_bits", c.c_int32),
        ("time_bits", c.c_int32),
        *((name, c.c_int64) for name in ("sampled_ns", "lead_ns", "older")),
        ("seen", c.c_uint64),
        ("shift", c.c_int64),
        *((name, c.c_int64) for name in ("trial", "trial_first", "trial_ns")),
        ("tried", c.c_int32),
        ("unturned", c.c_int32),
        ("ahead", c.c_int32),
    )

    def accept(self, counter: int, t_ns: int, t_us: int = 0) -> int:
        """The number of a sample that arrived at `t_ns`, or one of :class:`Rejection`."""
        header = Header(counter=counter, t_us=t_us)
        return int(_declared().receiver_accept(c.byref(self), c.byref(header), t_ns))


def receiver(
    period_ns: int, profile: E2EProfile, offset_ns: int = 0, time_bits: int = 0
) -> Receiver:
    """A receiver that has seen nothing yet.

    Sample j of the sender has the nominal time j * `period_ns` + `offset_ns`; `time_bits`: of the
    time stamp in its messages, 0: none.
    """
    return Receiver(
        sequence=-1,
        period_ns=period_ns,
        offset_ns=offset_ns,
        counter_bits=profile.counter_bits,
        time_bits=time_bits,
    )


def encode(message: Message, values: Any, header: Header, frame: Frame) -> None:
    """Fill id, flags, length and data of `frame`. `values`: a ctypes or float64 array's pointer."""
    _declared().message_encode(c.byref(message), values, c.byref(header), c.byref(frame))


def decode(message: Message, frame: Frame, values: Any, header: Header) -> Decoded:
    """Fill `values` and `header` from `frame`; when not OK, `values` is as it was."""
    return Decoded(
        _declared().message_decode(c.byref(message), c.byref(frame), values, c.byref(header))
    )


def protect(profile: E2EProfile, data_ids: bytes, counter: int, data: bytes) -> bytes:
    """`data` with the header of the profile written over its first bytes. `data_ids`: 16 bytes."""
    buffer = (c.c_uint8 * len(data)).from_buffer_copy(data)
    _declared().e2e_protect(profile, data_ids, counter, buffer, len(data))
    return bytes(buffer)


def check(profile: E2EProfile, data_ids: bytes, data: bytes) -> tuple[Decoded, int]:
    """Whether length and CRC are right, and the counter. `data_ids`: 16 bytes."""
    counter = c.c_uint32()
    result = _declared().e2e_check(profile, data_ids, data, len(data), c.byref(counter))
    return Decoded(result), counter.value


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    lib.message_encode.argtypes = (
        *(c.POINTER(Message), c.c_void_p, c.POINTER(Header), c.POINTER(Frame)),
    )
    lib.message_encode.restype = None
    lib.message_decode.argtypes = (
        *(c.POINTER(Message), c.POINTER(Frame), c.c_void_p, c.POINTER(Header)),
    )
    lib.message_decode.restype = c.c_int32
    lib.e2e_protect.argtypes = (c.c_int32, c.c_char_p, c.c_uint32, c.c_void_p, c.c_int32)
    lib.e2e_protect.restype = None
    lib.e2e_check.argtypes = (*(c.c_int32, c.c_char_p, c.c_char_p, c.c_int32, c.c_void_p),)
    lib.e2e_check.restype = c.c_int32
    lib.receiver_accept.argtypes = (c.POINTER(Receiver), c.POINTER(Header), c.c_int64)
    lib.receiver_accept.restype = c.c_int64
    return lib
