"""``message.h``, ``e2e.h``, ``receiver.h``, ``limit.h``: tables of fields, encoding, protection,
counters, as ctypes sees them.
"""

from __future__ import annotations

import ctypes as c
from itertools import takewhile
from typing import Any

from bridge.native import enums
from bridge.native.enums import Decoded, E2EProfile, FieldKind, LifeState, Rejection, Status
from bridge.native.library import library
from bridge.native.structs import Field, Frame, Header, Limit, Message, Receiver

__all__ = [
    "COUNTERS", "EARLY_NS", "FIELDS", "REFUSALS", "STAMP_TURNS", "Decoded", "E2EProfile",
    "Field", "FieldKind", "Header", "Limit", "Message", "Receiver", "Rejection", "accept",
    "carries_state", "check", "counter_bits", "decode", "encode", "header_bytes", "is_preview",
    "protect", "receiver",
]  # fmt: skip
#: The most values a message may have.
FIELDS = enums.MESSAGE_FIELDS
#: Turns of a short time stamp among which the counter decides.
STAMP_TURNS = enums.RECEIVE_TURNS
#: How far ahead of its time a sample is believed, ns, if its period is less.
EARLY_NS = enums.RECEIVE_EARLY_NS
#: What a receiver counts, in the order of ``receiver_t``.
COUNTERS = tuple(takewhile(lambda name: name != "sequence", (f[0] for f in Receiver._fields_)))
#: Those of frames that came and were refused.
REFUSALS = ("crc", "length", "invalid", "range", "rate", "simulated", "stale", "wrong_sequence")


def counter_bits(profile: E2EProfile) -> int:
    """Bits of the counter of a profile."""
    return {E2EProfile.NONE: 0, E2EProfile.P02: 4, E2EProfile.P04: 16, E2EProfile.P05: 8}[profile]


def header_bytes(profile: E2EProfile) -> int:
    """Bytes that a profile needs at the start of the data."""
    return {E2EProfile.NONE: 0, E2EProfile.P02: 2, E2EProfile.P04: 12, E2EProfile.P05: 3}[profile]


def carries_state(message: Message) -> bool:
    """True if its status contains the state of the sender; 4 bits (classic CAN) do not."""
    return bool(message.status >= 0 and message.header[message.status].scale == 1.0)


def is_preview(message: Message, status: int) -> bool:
    """True if this status byte is from a configured sender that waits for its start.

    Such a frame contains the values with which its sender will start. It is not a sample of a run,
    and receivers do not count it.
    """
    waiting = (int(LifeState.UNCONFIGURED), int(LifeState.INACTIVE))
    return carries_state(message) and status & int(Status.LIFE) in waiting


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
        counter_bits=counter_bits(profile),
        time_bits=time_bits,
    )


def accept(receiver: Receiver, counter: int, t_ns: int, t_us: int = 0) -> int:
    """The number of a sample that arrived at `t_ns`, or one of :class:`Rejection`."""
    header = Header(counter=counter, t_us=t_us)
    return int(library().receiver_accept(c.byref(receiver), c.byref(header), t_ns))


def encode(message: Message, values: Any, header: Header, frame: Frame) -> None:
    """Fill id, flags, length and data of `frame`. `values`: a ctypes or float64 array's pointer."""
    library().message_encode(c.byref(message), values, c.byref(header), c.byref(frame))


def decode(message: Message, frame: Frame, values: Any, header: Header) -> Decoded:
    """Fill `values` and `header` from `frame`; when not OK, `values` is as it was."""
    return Decoded(
        library().message_decode(c.byref(message), c.byref(frame), values, c.byref(header))
    )


def protect(profile: E2EProfile, data_ids: bytes, counter: int, data: bytes) -> bytes:
    """`data` with the header of the profile written over its first bytes. `data_ids`: 16 bytes."""
    buffer = (c.c_uint8 * len(data)).from_buffer_copy(data)
    library().e2e_protect(profile, data_ids, counter, buffer, len(data))
    return bytes(buffer)


def check(profile: E2EProfile, data_ids: bytes, data: bytes) -> tuple[Decoded, int]:
    """True if length and CRC are right, and the counter. `data_ids`: 16 bytes."""
    counter = c.c_uint32()
    result = library().e2e_check(profile, data_ids, data, len(data), c.byref(counter))
    return Decoded(result), counter.value
