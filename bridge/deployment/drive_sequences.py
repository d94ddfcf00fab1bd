"""Drives with their own protocols: the frames that enable, disable and clear them.

A node that commands such drives disables them when its torque has ended in FAULT; an emulated drive
follows the same frames. Both are tables for ``bridge/c/sequence.c``, made here of profiles.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bridge.deployment.cut import Inlet, NodePlan, Outlet
from bridge.deployment.drive_messages import profile_of
from bridge.deployment.spec import Deployment
from bridge.drives.profiles import DriveProfile
from bridge.native import node as native
from bridge.native.bus import FORMAT, Accept
from bridge.native.frame import Frame
from bridge.native.safety import DriveRequest

#: Sequences of a profile, and what each asks a drive for.
REQUESTS = {
    "enable": DriveRequest.ENABLE,
    "disable": DriveRequest.DISABLE,
    "clear": DriveRequest.CLEAR,
}


@dataclass(frozen=True, slots=True)
class Foreign:
    """A drive that takes a message of a profile: its number `node` on its bus."""

    bus: str
    profile: DriveProfile
    node: int

    def frames(self, *sequences: str) -> list[Frame]:
        """The frames of these sequences, one after the other."""
        raws = [raw for name in sequences for raw in self.profile.frames(name, self.node)]
        return [self.frame(*raw) for raw in raws]

    def frame(self, identifier: int, data: bytes) -> Frame:
        """A frame in the format of the drive's commands."""
        return Frame.of(identifier, data, self.profile.format)


def commands(d: Deployment, outlet: Outlet) -> bool:
    """Whether an outlet's message carries torque to a drive with its own protocol."""
    return bool(d.messages[outlet.message].profile) and any(p.port == "tau" for p in outlet.parts)


def commanded_drives(d: Deployment, plan: NodePlan) -> tuple[Foreign, ...]:
    """The drives that a node sends torques to by a profile, each once."""
    found = {}
    for outlet in plan.outlets:
        if commands(d, outlet):
            spec = d.messages[outlet.message]
            drive = Foreign(spec.bus, profile_of(d, outlet.message), spec.drive)
            found[spec.bus, spec.drive] = drive
    return tuple(found.values())


def emulated(d: Deployment, node: str, inlet: Inlet) -> Foreign | None:
    """The drive behind an input of a node, if it is emulated as a profile describes it."""
    spec, drive = d.messages[inlet.message], d.nodes[node].drive
    if drive is None or inlet.target.port != drive.port or not spec.profile:
        return None
    return Foreign(spec.bus, profile_of(d, inlet.message), spec.drive)


def accepted_frames(d: Deployment, plan: NodePlan, node: str, bus: str) -> tuple[Accept, ...]:
    """Frames of sequences that the emulated drives of a node follow on a bus."""
    drives = [emulated(d, node, inlet) for inlet in plan.inlets]
    found = {
        (f.id, f.flags & FORMAT)
        for drive in drives
        if drive and drive.bus == bus
        for f in drive.frames(*REQUESTS)
    }
    return tuple(Accept(number, flags=kind, flag_mask=FORMAT) for number, kind in sorted(found))


def table(drives: Iterable[Foreign], buses: Sequence[str], *sequences: str) -> c.Array[Frame]:
    """The frames of these sequences of all drives, each with the number of its bus, for C."""
    found = []
    for drive in drives:
        for frame in drive.frames(*sequences):
            frame.bus = buses.index(drive.bus)
            found.append(frame)
    return (Frame * max(1, len(found)))(*found)


def sequence_struct(
    drive: Foreign, buses: Sequence[str]
) -> tuple[c.Array[native.Sequence], list[object]]:
    """The frame sequence of an emulated drive as a C struct, and the memory that it needs."""
    names = [name for name in REQUESTS if drive.profile.sequences[name]]
    frames = [table([drive], buses, name) for name in names]
    sequences = (native.Sequence * max(1, len(names)))(
        *(
            native.Sequence(frames=f, count=len(f), request=REQUESTS[name])
            for name, f in zip(names, frames, strict=True)
        )
    )
    return sequences, [sequences, *frames]
