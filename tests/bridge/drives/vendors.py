"""A vendor's drive in C on a bus of its own, driven frame by frame."""

from __future__ import annotations

import ctypes as c
import struct
from dataclasses import dataclass
from typing import Any, final

from bridge.native.frame import Flags, Frame
from bridge.native.vendor import PARTS, VendorFault, VendorKind, VendorStruct, functions

MS, HALF = 1_000_000, 500_000
N = 3  # the number of these drives
BRS = int(Flags.FD | Flags.BRS)
#: Identifier of each feedback frame of node 0, and of one node further.
FEEDBACK = {
    VendorKind.DAMIAO: ((0x010, 1),),
    VendorKind.ODRIVE: ((0x009, 32), (0x01C, 32)),
    VendorKind.CIA402: ((0x180, 1), (0x280, 1)),
}


@dataclass(frozen=True)
class Said:
    """A frame that the drive has sent."""

    t_ns: int
    id: int
    data: bytes
    flags: int


@final
class Drive:
    """A drive, number `node`; `t` ns is the time of what was told last."""

    def __init__(self, kind: VendorKind, node: int = N, **settings: Any) -> None:
        values = {
            "timeout_ns": 20 * MS, "cycle_ns": MS, "boot_ns": 50 * MS, "p_max": 12.5, "v_max": 30.0,
            "t_max": 10.0, "rated": 1.0, "host": 2 if kind == VendorKind.CIA402 else 0,
        }  # fmt: skip
        values |= {"beat_ns": 100 * MS if kind == VendorKind.ODRIVE else 0, **settings}
        self.v, self.t, self.kind = VendorStruct(kind=kind, node=node, **values), 0, kind
        self.call("init", 0)

    def call(self, name: str, *arguments: Any) -> int:
        """A function of vendor.h."""
        found = getattr(functions(), f"vendor_{name}")(c.byref(self.v), *arguments)
        return int(found or 0)

    def at(self, t_ns: int) -> None:
        """It becomes t_ns."""
        self.t = t_ns
        self.call("step", t_ns)

    def hears(self, identifier: int, data: bytes, flags: int = 0) -> None:
        """A frame comes at the time of now."""
        self.call("take", c.byref(Frame.of(identifier, data, flags)), self.t)

    def fault(self, fault: VendorFault, code: int = 0) -> None:
        """Something happens to it now."""
        self.call("fault", fault, code, self.t)

    def says(self, payload: bytes = bytes(8)) -> list[Said]:
        """The frames sent until now; each feedback that it owes has this payload."""
        for part, (identifier, step) in enumerate(FEEDBACK[self.kind][:PARTS]):
            frame = Frame.of(identifier + step * self.v.node, payload)
            for _ in range(self.v.owed[part]):
                self.call("say", part, c.byref(frame), self.t)
        return self.sent()

    def sent(self) -> list[Said]:
        """The frames that it has sent until now."""
        found, frame = [], Frame()
        while self.call("next", self.t, c.byref(frame)):
            found.append(Said(frame.t_ns, frame.id, frame.payload, frame.flags))
        return found


def mit(tau: float, t_max: float = 10.0) -> bytes:
    """A MIT command of this torque, N.m, and nothing else."""
    code = round((tau / t_max + 1) / 2 * 4095)
    return bytes([0x80, 0, 0x80, 0, 0, 0, code >> 8, code & 255])


def damiao_enabled(**more: Any) -> Drive:
    """It has been enabled 2 ms ago."""
    drive = Drive(VendorKind.DAMIAO, **more)
    drive.hears(N, b"\xff" * 7 + b"\xfc")
    drive.at(2 * MS)
    assert drive.says()[-1].data[0] == 0x10 | N
    return drive


def odrive_enabled(**more: Any) -> Drive:
    """In torque control and closed loop for 1 ms."""
    drive = Drive(VendorKind.ODRIVE, **more)
    drive.hears(N << 5 | 0x0B, struct.pack("<II", 1, 1))
    drive.hears(N << 5 | 7, struct.pack("<I", 8))
    drive.at(2 * MS)
    assert drive.v.acts
    return drive


def rpdo(word: int, torque: int = 0, mode: int = 10) -> bytes:
    """RPDO1: control word, mode, torque in 1/1000."""
    return struct.pack("<Hbh", word, mode, torque)


def cia_enabled(**more: Any) -> Drive:
    """Operational and enabled, its host heard at t = 0."""
    drive = Drive(VendorKind.CIA402, **more)
    drive.hears(0x702, b"\x7f")
    drive.hears(0, bytes([1, N]))
    for n, word in enumerate((0x06, 0x07, 0x0F)):
        drive.hears(0x200 + N, rpdo(word))
        drive.at((n + 1) * 2 * MS)
    assert drive.v.acts
    return drive
