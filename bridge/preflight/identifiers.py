"""Users of each identifier on a CAN bus: messages, services and drives, in both directions.

A drive has more frames than the messages that a deployment names: frames that enable, disable and
clear it, its registers and their answers, unused feedback, and frames that CANopen devices send on
their own. Two users of one identifier are an error, even if one of them is not a message.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

from bridge.can.layout import MessageLayout
from bridge.deployment.drive_messages import profile_of
from bridge.deployment.services import commanding_nodes
from bridge.deployment.system import System
from bridge.drives.profiles import DriveProfile, ProfileMessage
from bridge.native.frame import Flags
from cosim.checks import Finding

#: Of a CANopen device besides its PDOs (CiA 301): first identifier, to which its number is added.
CANOPEN = {"EMCY": 0x080, "SDO answer": 0x580, "SDO request": 0x600, "heartbeat": 0x700}


@dataclass(frozen=True, slots=True)
class SentIdentifier:
    """An identifier that is sent on a bus; `party`: the sender and the message, for an error
    message.

    `of`: its protocol: frames of one protocol may share an identifier, because their content
    distinguishes them; "": not shared. `message`: of the deployment.
    """

    identifier: int
    extended: bool
    party: str
    of: str = ""
    message: bool = False

    def collides(self, other: SentIdentifier) -> bool:
        """True if two parties cannot both have it."""
        same = (self.identifier, self.extended) == (other.identifier, other.extended)
        together = self.of and self.of == other.of and not (self.message and other.message)
        return same and not together


def claims(system: System, bus: str) -> list[SentIdentifier]:
    """All identifiers of a CAN bus."""
    found = [*_messages(system, bus), *_services(system, bus)]
    seen: dict[SentIdentifier, None] = {}
    for name, m in system.deployment.messages.items():
        if m.bus == bus and m.profile:
            profile = profile_of(system.deployment, name)
            seen |= dict.fromkeys(_drive(profile, m.drive))
    return [*found, *seen, *_hosts(system, bus)]


def collisions(system: System) -> list[Finding]:
    """An error for each identifier that two parties of a bus have: the first two of them."""
    found: dict[tuple[str, int, bool], Finding] = {}
    for bus, spec in system.deployment.buses.items():
        if spec.kind != "can":
            continue
        for a, b in combinations(claims(system, bus), 2):
            if a.collides(b):
                found.setdefault((bus, a.identifier, a.extended), _finding(bus, a, b))
    return list(found.values())


def _finding(bus: str, a: SentIdentifier, b: SentIdentifier) -> Finding:
    number = f"{a.identifier:#010x}" if a.extended else f"{a.identifier:#05x}"
    return Finding(
        rule="identifier",
        severity="error",
        where=f"bus {bus}",
        number=a.identifier,
        unit="",
        reason=f"identifier {number} is used by {a.party} and by {b.party}",
        advice="use different identifiers, or separate buses",
    )


def _messages(system: System, bus: str) -> Iterator[SentIdentifier]:
    for name, m in system.messages.items():
        if m.bus == bus:
            struct, spec, of = m.encoding.message, system.deployment.messages[name], ""
            if spec.profile:
                profile = profile_of(system.deployment, name)
                command = profile.layout(profile.command, spec.drive).identifier
                of = (_to if struct.id == command else _from)(profile, spec.drive)
            extended = bool(struct.flags & Flags.EXTENDED)
            yield SentIdentifier(int(struct.id), extended, f"message {name} of {m.node}", of, True)


def _services(system: System, bus: str) -> Iterator[SentIdentifier]:
    """Services; each has its own senders, which alternate or send the same."""
    here = {n: s for n, s in system.deployment.nodes.items() if bus in system.buses_of(n)}
    numbers = {f"HEARTBEAT_{spec.number}": node for node, spec in here.items()}
    for name, encoding in system.services[bus].named().items():
        if name.startswith("HEARTBEAT") and name not in numbers:
            continue
        party = f"{name} of {numbers[name]}" if name in numbers else f"{name}, a service of the bus"
        extended = bool(encoding.message.flags & Flags.EXTENDED)
        yield SentIdentifier(int(encoding.message.id), extended, party)


def _hosts(system: System, bus: str) -> Iterator[SentIdentifier]:
    """Messages, other than commands, that drives receive from the nodes that command them."""
    service, d = system.services[bus], system.deployment
    for node in commanding_nodes(d, bus):
        beat = service.host_heartbeats.get(d.nodes[node].number)
        if beat is not None:
            yield SentIdentifier(int(beat.message.id), False, f"the CANopen heartbeat of {node}")
    if service.host_sync is not None:
        yield SentIdentifier(int(service.host_sync.message.id), False, "CANopen's SYNC")


def _drive(profile: DriveProfile, node: int) -> Iterator[SentIdentifier]:
    """All frames to and from a drive of this number on its bus."""
    drive = f"drive {node} ({profile.title or profile.path})"
    for sequence, raws in profile.sequences.items():
        for raw in raws:
            of = _to(profile, node if raw.step else None)
            yield SentIdentifier(raw.at(node)[0], False, f"{sequence} of {drive}", of)
    own = profile.watchdog
    for what, one in (("register", own.write), ("register", own.read)):
        if one is not None:
            of = _to(profile, node if one.step else None)
            yield SentIdentifier(one.at(node)[0], False, f"{what} frames to {drive}", of)
    if own.reply is not None:
        yield SentIdentifier(
            own.reply.at(node)[0], False, f"answers of {drive}", _from(profile, node)
        )
    command = profile.layout(profile.command, node)
    to = _to(profile, node)
    yield SentIdentifier(
        command.identifier, bool(command.flags & Flags.EXTENDED), f"commands to {drive}", to
    )
    for told in _feedback_frames(profile, node):
        extended = bool(told.flags & Flags.EXTENDED)
        yield SentIdentifier(
            told.identifier, extended, f"{told.name} of {drive}", _from(profile, node)
        )
    if profile.host.heartbeat:
        for name, first in CANOPEN.items():
            yield SentIdentifier(first + node, False, f"the {name} of {drive}")


def _feedback_frames(profile: DriveProfile, node: int) -> Iterator[MessageLayout]:
    """Frames that a drive sends: feedback, and all other messages of its DBC file."""
    yield from (profile.layout(part, node) for part in profile.feedback)
    known = {part.message for part in (profile.command, *profile.feedback)}
    known |= {profile.host.heartbeat, profile.host.sync}
    if profile.command.step:
        for layout in profile.layouts:
            if layout.name not in known:
                yield profile.layout(ProfileMessage(layout.name, profile.command.step), node)


def _to(profile: DriveProfile, node: int | None) -> str:
    return f"to {profile.protocol} {'all' if node is None else node}"


def _from(profile: DriveProfile, node: int) -> str:
    return f"from {profile.protocol} {node}"
