"""Drives with their own protocols: those that a node commands, and the frames of their sequences.

A node brings such drives up after ARM and disables them at its end (``bridge/c/bringup.c``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bridge.deployment.cut import Inlet, NodePlan, Outlet
from bridge.deployment.drive_messages import profile_of
from bridge.deployment.spec import Deployment
from bridge.drives.profiles import DriveProfile
from bridge.drives.raw_frames import Raw
from bridge.native.bus import ALL_BITS, KIND, Accept
from bridge.native.frame import Flags, Frame
from bridge.native.vendor import VendorKind

#: ns; torque 0 is sent five times in the shortest watchdog, between these limits.
FEED_NS = (5_000_000, 20_000_000)


@dataclass(frozen=True, slots=True)
class Foreign:
    """A drive that takes a message of a profile: its number `node` on its bus."""

    bus: str
    profile: DriveProfile
    node: int

    @property
    def name(self) -> str:
        """The drive for people: ``drive 3 on bus left``."""
        return f"drive {self.node} on bus {self.bus}"

    def frames(self, *sequences: str) -> list[Frame]:
        """The frames of these sequences, one after the other."""
        raws = [raw for name in sequences for raw in self.profile.frames(name, self.node)]
        return [self.frame(*raw) for raw in raws]

    def frame(self, identifier: int, data: bytes) -> Frame:
        """A frame in the format of the drive's commands."""
        return Frame.of(identifier, data, self.profile.format)

    def torque(self, value: float) -> tuple[int, bytes]:
        """Identifier and data of a command with this torque for each joint, in the DBC's unit."""
        codec = self.profile.codec(self.profile.command, self.node)
        return codec.layout.identifier, codec.encode([value] * self.profile.joints)

    @property
    def status(self) -> Accept:
        """The frames in which it tells its state, classic or CAN FD."""
        return Accept(self.profile.status_layout(self.node).identifier, flag_mask=KIND)

    @property
    def watchdog_value(self) -> int:
        """The value of the register of its watchdog; 0: its profile does not set it."""
        own = self.profile.watchdog
        return own.raw(self.profile.timeout) if own.write or own.read else 0

    def steps(self) -> list[Raw | tuple[Raw, Raw]]:
        """The frames that bring it up, in their order; with an answer: two of them."""
        own, sequences = self.profile.watchdog, self.profile.sequences
        found: list[Raw | tuple[Raw, Raw]] = []
        if own.write is not None:
            found.append(own.write)
        if own.read is not None and own.reply is not None:
            found.append((own.read, own.reply))
        return [*found, *sequences["clear"], *sequences["enable"]]

    def expected(self, step: int) -> tuple[str, ...]:
        """Names of the states, or the register, that have to follow a step."""
        one = self.steps()[step]
        return (self.profile.watchdog.register,) if isinstance(one, tuple) else one.expect

    def wrong_value(self, word: int) -> str:
        """The sentence on an answer of the watchdog's register that has another time-out."""
        own = self.profile.watchdog
        assert own.reply is not None
        identifier, data = own.reply.at(self.node)[0], word.to_bytes(8, "little")
        return own.wrong_value(self.profile.timeout, self.node, identifier, data)

    def answers(self) -> tuple[Accept, ...]:
        """The frames that its node reads of it, besides those of messages."""
        own = self.profile.watchdog
        status = (self.status,) if self.profile.status.message else ()
        if own.reply is None:
            return status
        return (*status, Accept(own.reply.at(self.node)[0], flag_mask=KIND))


def commands(d: Deployment, outlet: Outlet) -> bool:
    """True if an outlet's message carries torque to a drive with its own protocol."""
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


def feed_ns(drives: Sequence[Foreign]) -> int:
    """The time between two frames that feed these drives before the first slot, ns."""
    shortest = min((d.profile.timeout for d in drives if d.profile.timeout > 0), default=1.0)
    least, most = FEED_NS
    return min(max(round(shortest * 1e9 / 5), least), most)


def emulated(d: Deployment, node: str, inlet: Inlet) -> Foreign | None:
    """The drive behind an input of a node, if it is emulated as a profile describes it."""
    spec, drive = d.messages[inlet.message], d.nodes[node].drive
    if drive is None or inlet.target.port != drive.port or not spec.profile:
        return None
    return Foreign(spec.bus, profile_of(d, inlet.message), spec.drive)


def commanding(d: Deployment, message: str) -> str:
    """The node that sends a message; "": none does."""
    component = d.messages[message].carries[0].partition(".")[0]
    return next((name for name, n in d.nodes.items() if component in n.components), "")


def _heard(d: Deployment, drive: Foreign, message: str) -> list[Accept]:
    """Frames that a drive of a vendor hears besides torques, in any format."""
    host = commanding(d, message)
    beats = 0x700 + d.nodes[host].number if host else 0x700
    found = {
        VendorKind.DAMIAO: [(drive.node, ALL_BITS), (0x7FF, ALL_BITS)],
        VendorKind.ODRIVE: [(drive.node << 5, 0x7E0)],
        VendorKind.CIA402: [(n, ALL_BITS) for n in (0, 0x80, 0x200 + drive.node, beats)],
    }
    odd = Flags.EXTENDED | Flags.ERROR
    kind = VendorKind[drive.profile.vendor.upper()]
    return [Accept(number, mask, flag_mask=odd) for number, mask in found[kind]]


def accepted_frames(d: Deployment, plan: NodePlan, node: str, bus: str) -> tuple[Accept, ...]:
    """Frames on a bus that the emulated drives of a node follow, and that its real drives tell."""
    behind = [(emulated(d, node, inlet), inlet.message) for inlet in plan.inlets]
    here = [(drive, message) for drive, message in behind if drive and drive.bus == bus]
    heard = [a for x, message in here if x.profile.vendor for a in _heard(d, x, message)]
    answers = [a for x in commanded_drives(d, plan) if x.bus == bus for a in x.answers()]
    return (*heard, *answers)


def drive_names(numbers: Sequence[int], bus: str) -> str:
    """``drive 1 on bus left``, or ``drive 1 (and 2, 3) on bus left``."""
    others = ", ".join(map(str, numbers[1:]))
    return f"drive {numbers[0]}{f' (and {others})' if others else ''} on bus {bus}"


def own_torques(deployment: Deployment, node: str, plan: NodePlan) -> list[str]:
    """The messages with torques for the drive of our own protocol that a node emulates, if any."""
    drive = deployment.nodes[node].drive
    taken = {i.message for i in plan.inlets if drive is not None and i.target.port == drive.port}
    return sorted(message for message in taken if not deployment.messages[message].profile)
