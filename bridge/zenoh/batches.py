"""Several samples of one message in one payload: what a node in lock-step has sent in a window.

Each sample has two bytes before it, its length (little endian). The encoding says that it is such a
payload; a single sample is sent as it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import zenoh

ENCODING = zenoh.Encoding("application/octet-stream;cosim.samples.v1")
#: Bytes of a length.
_LENGTH = 2


def joined(samples: Sequence[bytes]) -> bytes:
    """The payload of samples, each of less than 65536 bytes."""
    return b"".join(len(one).to_bytes(_LENGTH, "little") + one for one in samples)


def samples_of(message: zenoh.Sample) -> Sequence[bytes]:
    """The samples of a message, in order."""
    data = message.payload.to_bytes()
    return list(_split(data)) if message.encoding == ENCODING else (data,)


def _split(data: bytes) -> Iterator[bytes]:
    at = 0
    while at + _LENGTH <= len(data):
        end = at + _LENGTH + int.from_bytes(data[at : at + _LENGTH], "little")
        yield data[at + _LENGTH : end]
        at = end
