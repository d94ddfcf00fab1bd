"""The packet of a ping: a question and its answer have the same size and layout.

All fields little endian; times are ns of the monotonic clock of the host that writes them::

    "CPNG", version 1, kind (0 question, 1 answer), count u16
    host u64     identifies the clock of the sender: equal numbers are one clock
    k u64        number of the question
    t1 i64       question sent                     heard u64   different questions heard from this
                                                               sender in the count `count`
    t2 i64       question received                 wake i64    from arrival to processing
    t3 i64       answer sent                       date i64    date less monotonic clock, ns
    error i64    maximum error of the date, ns; -1: no time server keeps it

The rest, up to the size asked for, is zero. An answer is never longer than its question, so a
responder cannot be used to multiply traffic.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from cosim.base.copies import replace

_LAYOUT = struct.Struct("<4sBBHQQqQqqqqq")
_MAGIC, _VERSION = b"CPNG", 1
#: Size of a packet without padding, bytes.
LEAST = _LAYOUT.size


@dataclass(frozen=True, slots=True)
class PingPacket:
    """The fields of a packet; times in ns.

    `count`: of an answer, another number where the responder began to count anew.
    """

    answer: bool
    host: int
    k: int
    t1: int
    heard: int = 0
    t2: int = 0
    wake: int = 0
    t3: int = 0
    date: int = 0
    error: int = -1
    count: int = 0

    def encode(self, size: int = LEAST) -> bytes:
        """The bytes, padded with zeros to `size`."""
        packed = _LAYOUT.pack(
            _MAGIC, _VERSION, self.answer, self.count, self.host, self.k, self.t1, self.heard,
            self.t2, self.wake, self.t3, self.date, self.error,
        )  # fmt: skip
        return packed.ljust(size, b"\0")

    def answered(self, **fields: int) -> PingPacket:
        """The answer to this question, with the fields of the responder."""
        return replace(self, answer=True, **fields)


def decode(data: bytes) -> PingPacket | None:
    """The packet in `data`; None for anything else."""
    if len(data) < LEAST:
        return None
    magic, version, kind, count, *fields = _LAYOUT.unpack_from(data)
    if magic != _MAGIC or version != _VERSION or kind > 1:
        return None
    return replace(PingPacket(bool(kind), *fields), count=count)
