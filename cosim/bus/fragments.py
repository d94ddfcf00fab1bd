"""Messages larger than a frame: the frames of Zenoh and of ISO-TP for one message.

**Zenoh** on a link whose unit is one CAN FD frame sends a message that does not fit as fragments,
one a frame. In bytes, with a sequence number of 4 bytes (of 28 bits) as in almost every session::

    message    1 header, 1 key (declared before), 2 quality unless default, 1 put, length, payload
               with an attachment: 1 header, length, attachment
    frame      1 header, 4 number, 2 priority unless DATA, then the message
    fragment   1 header, 4 number, 2 priority unless DATA, 1 mark in the first, then a part

**ISO-TP** puts 62 bytes into a single FD frame (7 into a classic one) or into the first frame (6),
and 63 into each consecutive one (7); the receiver answers the first frame, and each block of
consecutive ones, with a flow control.

Source: the bytes of Zenoh sessions (``tests/cosim/bus/test_zenoh_frames.py`` compares them);
zenoh pull request 2757 (one frame is the unit of the link); ISO 15765-2:2016, 9.6.
"""

from __future__ import annotations

from dataclasses import dataclass

from cosim.bus.timing import TimingError, padded

#: Bytes of a sequence number of 28 bits, seven bits a byte.
NUMBER = 4
#: The greatest length of an ISO-TP message with a length of 12 bits, bytes.
ISOTP_LARGEST = 4095


def _varied(value: int) -> int:
    """Bytes of a number that has seven bits a byte."""
    return max(1, -(-value.bit_length() // 7))


@dataclass(frozen=True, slots=True)
class ZenohMessage:
    """A message that Zenoh publishes: bytes of its payload, and what Zenoh adds.

    `attachment`: its bytes, 0: none (rmw_zenoh: 33). `data_priority`: it has the priority DATA;
    `default_quality`: and is neither express nor kept under congestion.
    """

    payload: int
    attachment: int = 0
    data_priority: bool = False
    default_quality: bool = False

    def __post_init__(self) -> None:
        if self.payload < 0 or self.attachment < 0:
            raise TimingError("found a negative number of bytes, expected 0 or more")
        if self.default_quality and not self.data_priority:
            raise TimingError("found default_quality without data_priority, expected both")

    @property
    def length(self) -> int:
        """Bytes of the message."""
        attached = 1 + _varied(self.attachment) + self.attachment if self.attachment else 0
        quality = 0 if self.default_quality else 2
        return 3 + quality + attached + _varied(self.payload) + self.payload

    def frames(self, unit: int = 64, number: int = NUMBER) -> tuple[int, ...]:
        """Bytes of each frame on a link whose unit is `unit` bytes, before they are padded.

        `number`: bytes of the sequence number.
        """
        head = 1 + number + (0 if self.data_priority else 2)
        if head + self.length <= unit:
            return (head + self.length,)
        parts, left = [unit], self.length - (unit - head - 1)
        while left > 0:
            parts.append(head + min(left, unit - head))
            left -= unit - head
        return tuple(parts)


def isotp_frames(length: int, unit: int) -> tuple[int, ...]:
    """Bytes of each data frame of an ISO-TP message, as padded: first or single, consecutive.

    `unit`: 8 (classic CAN), or a length that CAN FD has. Raises TimingError for a length beyond
    4095 bytes, or no bytes.
    """
    if not 0 < length <= ISOTP_LARGEST:
        raise TimingError(f"found {length} bytes, expected 1 to {ISOTP_LARGEST} in ISO-TP")
    if padded(unit, fd=True) != unit or unit < 8:
        raise TimingError(f"found a unit of {unit} bytes, expected 8, 12, 16, 20, 24, 32, 48 or 64")
    if length <= 7:
        return (8,)
    if unit > 8 and length <= unit - 2:
        return (padded(length + 2, fd=True),)
    left, sizes = length - (unit - 2), [unit]
    while left > 0:
        sizes.append(max(8, padded(1 + min(left, unit - 1), fd=True)))
        left -= unit - 1
    return tuple(sizes)


def flow_controls(frames: int, block: int) -> int:
    """Flow controls of an ISO-TP message of so many data frames; `block`: 0, one for all."""
    consecutive = frames - 1
    if consecutive < 1:
        return 0
    return -(-consecutive // block) if block else 1
