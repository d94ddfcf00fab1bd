"""Drives with protocols of their own: watchdog written and read back, enabled, at the end disabled.

What a profile says in raw frames (``configs/drives``), sent by who supervises nodes that move real
drives. A drive whose watchdog does not read back as written is not enabled, and nothing starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from bridge.attach import can_spec
from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.can.profiles import Profile, load_profile
from bridge.native.bus import FORMAT, Accept
from bridge.native.frame import Frame
from bridge.system import System
from cosim.clock import monotonic_ns, sleep
from cosim.errors import RunError

#: s a drive may take to answer.
PATIENCE = 0.5


@dataclass(frozen=True, slots=True)
class Foreign:
    """A drive that takes a message of a profile: its number `node` on its bus."""

    bus: str
    profile: Profile
    node: int


def foreign_drives(system: System, nodes: Iterable[str]) -> tuple[Foreign, ...]:
    """The drives that these nodes send torques to by a profile, each once."""
    found: dict[tuple[str, int], Foreign] = {}
    d = system.deployment
    for name, message in system.messages.items():
        spec = d.messages[name]
        torque = any(part.port == "tau" for part in message.outlet.parts)
        if spec.profile and torque and message.node in nodes:
            drive = Foreign(spec.bus, load_profile(d.file(spec.profile)), spec.drive)
            found[spec.bus, spec.drive] = drive
    return tuple(found.values())


@contextmanager
def enabled(system: System, nodes: Iterable[str]) -> Iterator[tuple[Foreign, ...]]:
    """All foreign drives of these nodes enabled, and disabled at the end whatever happens.

    Raises RunError where a drive does not answer, ScenarioError where its watchdog is another one.
    """
    drives = foreign_drives(system, tuple(nodes))
    with ExitStack() as stack:
        ends: dict[str, Attachment] = {}
        for bus in {drive.bus for drive in drives}:
            ends[bus] = interface.attach(can_spec(system.deployment, bus))
            stack.callback(ends[bus].close)
        for drive in drives:
            _watchdog(drive, ends[drive.bus])
        for drive in drives:
            stack.callback(_send, drive, ends[drive.bus], "disable")
            _send(drive, ends[drive.bus], "clear")
            _send(drive, ends[drive.bus], "enable")
        yield drives


def _send(drive: Foreign, end: Attachment, sequence: str) -> None:
    for identifier, data in drive.profile.frames(sequence, drive.node):
        end.bus.send(Frame.of(identifier, data))


def _watchdog(drive: Foreign, end: Attachment) -> None:
    """Write the time-out and read it back, where the profile knows how."""
    own = drive.profile.watchdog
    if own.write is not None:
        end.bus.send(Frame.of(*own.write.at(drive.node, own.raw(drive.profile.timeout))))
    if own.read is None or own.reply is None:
        return
    end.bus.drain()
    end.bus.send(Frame.of(*own.read.at(drive.node)))
    answer = Accept(own.reply.at(drive.node)[0], flag_mask=FORMAT)
    until = monotonic_ns() + round(PATIENCE * 1e9)
    while monotonic_ns() < until:
        for frame in filter(answer.takes, end.bus.drain()):
            if own.check(drive.profile.timeout, drive.node, frame.id, frame.payload):
                return
        sleep(0.005)
    raise RunError(
        f"drive {drive.node} on bus {drive.bus} does not say its {own.register} within "
        f"{PATIENCE:g} s ({drive.profile.path}): it is not enabled"
    )
