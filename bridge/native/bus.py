"""``bus.h``: a bus as the tick uses it, its state, and its traffic in the last second."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self, final

import numpy as np

from bridge.native.enums import FRAME_FORMAT, TRAFFIC_SLOT_NS, BusKind, BusState
from bridge.native.frame import Ring
from bridge.native.journal import Journal
from bridge.native.library import library
from bridge.native.methods import ALL_BITS, KIND
from bridge.native.structs import Accept, BusStruct, Frame, TrafficStruct
from cosim.base.errors import CosimError

__all__ = [
    "ALL_BITS", "FORMAT", "KIND", "Accept", "Bus", "BusKind", "BusState", "BusStruct", "Rate",
    "TrafficStruct", "last_second", "traffic_add",
]  # fmt: skip
#: Flags by which any other message is told from other frames.
FORMAT = FRAME_FORMAT


@dataclass(frozen=True)
class Rate:
    """The rate of a bus in one second: frames, bits at the nominal rate, bits of CAN FD data
    phases.

    Bits contain inter-frame space and the stuff bits of random data (one in 30), not those of the
    frames that were there.
    """

    frames: int
    bits: float
    data_bits: float

    def load(self, bitrate: float, data_bitrate: float | None = None) -> float:
        """Part of the second the bus was taken; rates in bit/s."""
        return self.bits / bitrate + self.data_bits / (data_bitrate or bitrate)


def last_second(traffic: TrafficStruct, now_ns: int) -> Rate:
    """Frames and bits in the ten slots of 100 ms before the one of `now_ns` (monotonic).

    The counts may be written meanwhile.
    """
    number = np.array(traffic.number)
    now = now_ns // TRAFFIC_SLOT_NS
    there = (number >= now - 10) & (number < now)
    return Rate(
        int(np.array(traffic.slot_frames)[there].sum()),
        float(np.array(traffic.slot_bits)[there].sum()),
        float(np.array(traffic.slot_data_bits)[there].sum()),
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
        error = library().bus_prepare(descriptor)
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
        """Choose the frames that are given from now on; None: all. Others are logged and counted
        only.
        """
        if accepts is not None:
            self._accepts = (Accept * len(accepts))(*accepts)
            self.struct.accepts, self.struct.n_accepts = self._accepts, len(accepts)

    @property
    def state(self) -> BusState:
        """The state of controller and interface, as far as frames and errors told."""
        return BusState(self.struct.state)

    def receive(self, frame: Frame) -> bool:
        """The next frame that has arrived, into `frame`; False: none."""
        return bool(library().bus_receive(c.byref(self.struct), c.byref(frame)))

    def drain(self) -> list[Frame]:
        """All frames that have arrived."""
        frames = [Frame()]
        while self.receive(frames[-1]):
            frames.append(Frame())
        return frames[:-1]

    def send(self, frame: Frame) -> int:
        """Hand over a frame; 0, or an errno (counted). Sets its `t_ns`, not on a MEMORY bus."""
        return int(library().bus_send(c.byref(self.struct), c.byref(frame)))


def traffic_add(traffic: TrafficStruct, frame: Frame) -> None:
    """Count a frame as one that was on the bus."""
    library().traffic_add(c.byref(traffic), c.byref(frame))
