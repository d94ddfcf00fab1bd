"""Emulated drives of vendors in a node, as state machines of ``bridge/c/vendor.h``."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any, final

from bridge.deployment import drive_sequences
from bridge.deployment.cut import Inlet, Outlet
from bridge.deployment.drive_sequences import Foreign
from bridge.deployment.system import System
from bridge.drives.profiles import DriveProfile
from bridge.native import node as native
from bridge.native.frame import Flags
from bridge.native.safety import DriveStruct
from bridge.native.vendor import PARTS, VendorKind, VendorStruct

#: ns: control loop and power-up of each vendor's drives (assumed).
CYCLES = {VendorKind.DAMIAO: 100_000, VendorKind.ODRIVE: 125_000, VendorKind.CIA402: 1_000_000}
BOOTS = {
    VendorKind.DAMIAO: 300_000_000,
    VendorKind.ODRIVE: 800_000_000,
    VendorKind.CIA402: 500_000_000,
}
#: ns: from a request to its answer, and up to as much longer (assumed: a loop or two of a drive; a
#: CiA 402 drive reads a SYNC between its cycles).
ANSWERS = {VendorKind.DAMIAO: 100_000, VendorKind.ODRIVE: 125_000, VendorKind.CIA402: 250_000}
#: Identifiers of feedback frames of node 0, and what one node further adds.
_FEEDBACK = {
    VendorKind.DAMIAO: ((0x010,), 1),
    VendorKind.ODRIVE: ((0x009, 0x01C), 32),
    VendorKind.CIA402: ((0x180, 0x280), 1),
}


@final
class EmulatedMotors:
    """Binds the emulated drives of a node that have a vendor, and keeps their memory."""

    def __init__(self, system: System, name: str, struct: native.NodeStruct) -> None:
        d, self._system = system.deployment, system
        self._buses = system.buses_of(name)
        found: dict[tuple[str, int], tuple[Foreign, Inlet]] = {}
        for inlet in system.nodes[name].inlets:
            drive = drive_sequences.emulated(d, name, inlet)
            if drive is not None and drive.profile.vendor:
                found[drive.bus, drive.node] = drive, inlet
        self.drives = tuple(drive for drive, _ in found.values())
        self._alive: list[Any] = []
        self._places = {place: i for i, place in enumerate(found)}
        self.structs = (native.MotorStruct * max(1, len(found)))()
        for entry, (drive, inlet) in zip(self.structs, found.values(), strict=False):
            entry.bus, entry.outlets = self._buses.index(drive.bus), (-1,) * PARTS
            host = drive_sequences.commanding(d, inlet.message)
            entry.vendor = _vendor(drive, d.nodes[host].number if host else 0)
        struct.motors, struct.n_motors = self.structs, len(found)

    def follow(self, entry: native.InletStruct, drive: Foreign, model: DriveStruct) -> None:
        """Bind the torque input behind a drive; its watchdog is that of the emulated drive."""
        motor = self.structs[self._places[drive.bus, drive.node]]
        motor.vendor.timeout_ns = model.watchdog.timeout_ns
        entry.motor = native.pointer_to(motor)

    def suffer(self, bus: str, node: int, faults: Sequence[tuple[float, int, int]]) -> None:
        """Let faults (t in s, VENDOR_..., code) happen to a drive, in the order of time."""
        motor = self.structs[self._places[bus, node]]
        table = (native.MotorFault * max(1, len(faults)))(
            *(native.MotorFault(round(t * 1e9), fault, code) for t, fault, code in faults)
        )
        motor.faults, motor.n_faults, motor.happened = table, len(faults), 0
        self._alive.append(table)

    def tell(self, entry: native.OutletStruct, outlet: Outlet, number: int) -> None:
        """Bind a message of the node, if it is the feedback of one of these drives."""
        spec = self._system.deployment.messages[outlet.message]
        place = self._places.get((spec.bus, spec.drive))
        if place is None or not spec.profile:
            return
        motor, identifier = self.structs[place], entry.message.contents.id
        bases, step = _FEEDBACK[VendorKind(motor.vendor.kind)]
        for part, base in enumerate(bases):
            if identifier == base + step * spec.drive:
                entry.motor, entry.part = native.pointer_to(motor), part
                motor.outlets[part] = number


def _vendor(drive: Foreign, host: int) -> VendorStruct:
    profile, kind = drive.profile, VendorKind[drive.profile.vendor.upper()]
    ranges: dict[str, Any] = damiao_ranges(profile) if kind == VendorKind.DAMIAO else {}
    return VendorStruct(
        kind=kind,
        node=drive.node,
        format=int(profile.format & (Flags.FD | Flags.BRS)),
        host=host if kind == VendorKind.CIA402 else 0,
        cycle_ns=CYCLES[kind],
        boot_ns=BOOTS[kind],
        answer_ns=ANSWERS[kind],
        jitter_ns=ANSWERS[kind],
        beat_ns=round(profile.status.every * 1e9),
        rated=profile.rated_torque,
        seed=zlib.crc32(f"{drive.bus} {drive.node}".encode()),
        **ranges,
    )


def damiao_ranges(profile: DriveProfile) -> dict[str, float]:
    """P_MAX (rad), V_MAX (rad/s) and T_MAX (N.m) of drives of this profile: where codes begin."""
    layout = profile.layout(profile.command, 1)
    names = {"p_max": "q_des", "v_max": "dq_des", "t_max": profile.command.tau[0]}
    return {name: -layout.signal(signal).offset for name, signal in names.items()}
