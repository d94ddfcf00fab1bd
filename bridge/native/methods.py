"""Methods of frames and of rules that accept them: bases of the structs that a build makes."""

from __future__ import annotations

import ctypes as c
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bridge.native.enums import FRAME_DATA, FRAME_FORMAT, Flags
from cosim.base.errors import CosimError

ALL_BITS = 0xFFFFFFFF
#: Flags by which an emergency stop is told from other frames.
KIND = Flags.REMOTE | Flags.EXTENDED | Flags.ERROR


class IdAndFlags(Protocol):
    """A message or a frame: an identifier and flags."""

    @property
    def id(self) -> int:
        """The identifier, without the flags of ``linux/can.h``."""

    @property
    def flags(self) -> int:
        """Bits of :class:`Flags`."""


class FrameMethods(c.Structure):
    """A CAN frame, or a message of another network (256 bytes)."""

    @classmethod
    def of(cls, identifier: int, data: bytes = b"", flags: int = 0, t_ns: int = 0) -> Self:
        """A frame with these bytes. Raises CosimError for more than 232 of them."""
        if len(data) > FRAME_DATA:
            raise CosimError(f"frame {identifier:#x}: {len(data)} bytes; at most {FRAME_DATA} fit")
        frame = cls(t_ns=t_ns, id=identifier, flags=int(flags), length=len(data))
        c.memmove(frame.data, data, len(data))
        return frame

    @property
    def payload(self) -> bytes:
        """The `length` bytes of data."""
        return c.string_at(self.data, self.length)

    def key(self) -> tuple[int, int, bytes]:
        """Identifier, flags without SENT, and data: what a receiver can compare."""
        return self.id, self.flags & ~Flags.SENT, self.payload


class AcceptMethods(c.Structure):
    """Frames with this identifier and these flags under the two masks.

    Without flags: data frames, classic or CAN FD, with 11-bit identifiers.
    """

    def __init__(
        self, identifier: int, mask: int = ALL_BITS, flags: int = 0, flag_mask: int = KIND
    ) -> None:
        super().__init__(identifier, mask, int(flags), int(flag_mask))

    @classmethod
    def of(cls, message: IdAndFlags) -> Self:
        """Frames of a message: its identifier and its format, as `message_is` has it."""
        return cls(message.id, ALL_BITS, message.flags & FRAME_FORMAT, FRAME_FORMAT)

    def any_format(self) -> Self:
        """Frames of the same identifiers, also where they are remote frames, or CAN FD and not."""
        return type(self)(self.id, self.mask, self.flags, self.flag_mask & Flags.EXTENDED)

    @classmethod
    def for_estop(cls, message: IdAndFlags) -> Self:
        """Frames that are an emergency stop: classic or CAN FD, of any length."""
        return cls(message.id, ALL_BITS, message.flags & KIND, KIND)

    def takes(self, frame: IdAndFlags) -> bool:
        """True if it is one of these frames."""
        same = not (frame.id ^ self.id) & self.mask
        return same and not (frame.flags ^ self.flags) & self.flag_mask

    def among(self, rows: NDArray[np.void]) -> NDArray[np.bool_]:
        """A mask (rows,) of such frames in a log or record (fields `id` and `flags`)."""
        other_id = (rows["id"] ^ np.uint32(self.id)) & np.uint32(self.mask)
        flags = rows["flags"].astype(np.uint32)
        other_format = (flags ^ np.uint32(self.flags)) & np.uint32(self.flag_mask)
        return np.asarray((other_id == 0) & (other_format == 0))
