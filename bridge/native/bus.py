"""``bus.h``: a bus as the tick uses it, its state, and its traffic in the last second."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Self, final

import numpy as np
from numpy.typing import NDArray

from bridge.native.frame import Flags, Frame, Ring, RingStruct
from bridge.native.journal import Journal, JournalStruct
from bridge.native.library import library
from bridge.native.message import Message
from cosim.base.errors import CosimError

SLOTS, SLOT_NS = 16, 100_000_000
ALL_BITS = 0xFFFFFFFF
#: Flags by which an emergency stop is told from other frames, and (FORMAT) any other message.
KIND = Flags.REMOTE | Flags.EXTENDED | Flags.ERROR
FORMAT = KIND | Flags.FD


class BusKind(IntEnum):
    """``BUS_SOCKET`` and so on: what is behind a bus."""

    SOCKET = 1
    RING = 2
    MEMORY = 3


class BusState(IntEnum):
    """``BUS_ACTIVE`` and so on: of the controller, DOWN of the interface."""

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    OFF = 3
    DOWN = 4


@final
class Accept(c.Structure):
    """Frames with this identifier and these flags under the two masks (`accept_t`).

    Without flags: data frames, classic or CAN FD, with 11-bit identifiers.
    """

    _fields_ = (
        ("id", c.c_uint32),
        ("mask", c.c_uint32),
        ("flags", c.c_uint32),
        ("flag_mask", c.c_uint32),
    )

    def __init__(
        self, identifier: int, mask: int = ALL_BITS, flags: int = 0, flag_mask: int = KIND
    ) -> None:
        super().__init__(identifier, mask, int(flags), int(flag_mask))

    @classmethod
    def of(cls, message: Message) -> Accept:
        """Frames of a message: its identifier and its format, as `message_is` has it."""
        return cls(message.id, ALL_BITS, message.flags & FORMAT, FORMAT)

    def any_format(self) -> Accept:
        """Frames of the same identifiers, also where they are remote frames, or CAN FD and not."""
        return Accept(self.id, self.mask, self.flags, self.flag_mask & Flags.EXTENDED)

    @classmethod
    def for_estop(cls, message: Message) -> Accept:
        """Frames that are an emergency stop: classic or CAN FD, of any length."""
        return cls(message.id, ALL_BITS, message.flags & KIND, KIND)

    def takes(self, frame: Frame) -> bool:
        """Whether it is one of these frames."""
        same = not (frame.id ^ self.id) & self.mask
        return same and not (frame.flags ^ self.flags) & self.flag_mask

    def among(self, rows: NDArray[np.void]) -> NDArray[np.bool_]:
        """Which rows of a log or record (fields `id` and `flags`) are such frames, (rows,)."""
        other_id = (rows["id"] ^ np.uint32(self.id)) & np.uint32(self.mask)
        flags = rows["flags"].astype(np.uint32)
        other_format = (flags ^ np.uint32(self.flags)) & np.uint32(self.flag_mask)
        return np.asarray((other_id == 0) & (other_format == 0))


@final
class TrafficStruct(c.Structure):
    """What was on a bus, both ways (`traffic_t`); may be read while it is written."""

    _fields_ = (
        ("frames", c.c_int64),
        ("error_frames", c.c_int64),
        ("bits", c.c_double),
        ("data_bits", c.c_double),
        ("number", c.c_int64 * SLOTS),
        ("slot_frames", c.c_int64 * SLOTS),
        ("slot_bits", c.c_double * SLOTS),
        ("slot_data_bits", c.c_double * SLOTS),
    )

    def last_second(self, now_ns: int) -> Rate:
        """Frames and bits in the ten slots of 100 ms before the one of `now_ns` (monotonic)."""
        number = np.array(self.number)
        there = (number >= now_ns // SLOT_NS - 10) & (number < now_ns // SLOT_NS)
        return Rate(
            int(np.array(self.slot_frames)[there].sum()),
            float(np.array(self.slot_bits)[there].sum()),
            float(np.array(self.slot_data_bits)[there].sum()),
        )


@dataclass(frozen=True)
class Rate:
    """Of a bus in one second: frames, bits at the nominal rate, bits of CAN FD data phases.

    Bits contain inter-frame space and the stuff bits of random data (one in 30), not those of the
    frames that were there.
    """

    frames: int
    bits: float
    data_bits: float

    def load(self, bitrate: float, data_bitrate: float | None = None) -> float:
        """Part of the second the bus was taken; rates in bit/s."""
        return self.bits / bitrate + self.data_bits / (data_bitrate or bitrate)


#: Frames of one call to the kernel, at most.
BATCH = 8


class BusStruct(c.Structure):
    """``bus_t``."""

    _fields_ = (
        ("kind", c.c_int32),
        ("fd", c.c_int32),
        ("rx", c.POINTER(RingStruct)),
        ("tx", c.POINTER(RingStruct)),
        ("log", c.POINTER(JournalStruct)),
        ("received", c.c_int64),
        ("sent", c.c_int64),
        ("send_failed", c.c_int64),
        ("overruns", c.c_int64),
        ("error_frames", c.c_int64),
        ("state", c.c_int32),
        ("last_errno", c.c_int32),
        ("number", c.c_uint32),
        ("overflow", c.c_uint32),
        ("restarts", c.c_int64),
        ("tx_errors", c.c_int32),
        ("rx_errors", c.c_int32),
        ("accepts", c.POINTER(Accept)),
        ("n_accepts", c.c_int64),
        ("foreign", c.c_int64),
        ("traffic", c.POINTER(TrafficStruct)),
        ("offset_ns", c.c_int64),
        ("empty_ns", c.c_int64),
        ("clock_steps", c.c_int64),
        ("draining", c.c_int32),
        ("stepped", c.c_int32),
        ("wall_ns", c.c_int64),
        ("began_ns", c.c_int64),
        ("batched", c.c_int32),
        ("given", c.c_int32),
        ("emptied", c.c_int32),
        ("reserved", c.c_int32),
        ("batch", Frame * BATCH),
    )


@final
class Bus:
    """A `bus_t` with the memory to which it points. `struct` is for C, the methods are for Python.

    `log`: a journal of rows of type `frame_dtype` for every frame in both directions, or None.
    """

    def __init__(self, kind: BusKind, number: int, log: Journal | None) -> None:
        self.traffic = TrafficStruct()
        self.struct = BusStruct(kind=kind, fd=-1, number=number)
        self.struct.traffic = c.pointer(self.traffic)
        self.rx: Ring | None = None
        self.tx: Ring | None = None
        self.log = log
        self._accepts: c.Array[Accept] | None = None
        if log is not None:
            self.struct.log = c.pointer(log.struct)

    @classmethod
    def from_socket(
        cls, descriptor: int, number: int = 0, log: Journal | None = None, *,
        accepts: Sequence[Accept] | None = None,
    ) -> Self:  # fmt: skip
        """A raw AF_CAN socket (`bridge.can.socket.open_socket`), which stays the caller's.

        Raises CosimError where the kernel gives no arrival stamps.
        """
        error = _declared().bus_prepare(descriptor)
        if error:
            raise CosimError(f"socket {descriptor}: no arrival stamps (errno {error})")
        bus = cls(BusKind.SOCKET, number, log)
        bus.struct.fd = descriptor
        bus.accept(accepts)
        return bus

    @classmethod
    def from_rings(
        cls, rx: Ring, tx: Ring, number: int = 0, log: Journal | None = None, *,
        wake: int = -1, accepts: Sequence[Accept] | None = None, kind: BusKind = BusKind.RING,
    ) -> Self:  # fmt: skip
        """Rings to and from other threads, or (MEMORY) other nodes of this process.

        `wake`: a descriptor written to after each frame sent; -1: none. `accepts`: see
        :meth:`accept`.
        """
        bus = cls(kind, number, log)
        bus.rx, bus.tx = rx, tx
        bus.struct.fd = wake
        bus.struct.rx, bus.struct.tx = c.pointer(rx.struct), c.pointer(tx.struct)
        bus.accept(accepts)
        return bus

    def accept(self, accepts: Sequence[Accept] | None) -> None:
        """Which frames are given from now on; None: all. Others are logged and counted only."""
        if accepts is not None:
            self._accepts = (Accept * len(accepts))(*accepts)
            self.struct.accepts, self.struct.n_accepts = self._accepts, len(accepts)

    @property
    def state(self) -> BusState:
        """Of controller and interface, as far as frames and errors told."""
        return BusState(self.struct.state)

    def receive(self, frame: Frame) -> bool:
        """The next frame that has arrived, into `frame`; False: none."""
        return bool(_declared().bus_receive(c.byref(self.struct), c.byref(frame)))

    def drain(self) -> list[Frame]:
        """All frames that have arrived."""
        frames = [Frame()]
        while self.receive(frames[-1]):
            frames.append(Frame())
        return frames[:-1]

    def send(self, frame: Frame) -> int:
        """Hand over a frame; 0, or an errno (counted). Sets its `t_ns`, not on a MEMORY bus."""
        return int(_declared().bus_send(c.byref(self.struct), c.byref(frame)))


def traffic_add(traffic: TrafficStruct, frame: Frame) -> None:
    """Count a frame as one that was on the bus."""
    _declared().traffic_add(c.byref(traffic), c.byref(frame))


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    for function in (lib.bus_receive, lib.bus_send):
        function.argtypes = (c.POINTER(BusStruct), c.POINTER(Frame))
        function.restype = c.c_int32
    lib.bus_prepare.argtypes = (c.c_int32,)
    lib.bus_prepare.restype = c.c_int32
    lib.traffic_add.argtypes = (c.POINTER(TrafficStruct), c.POINTER(Frame))
    lib.traffic_add.restype = None
    return lib
