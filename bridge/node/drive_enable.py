"""Drives with their own protocols: watchdog set and read back, enabled, disabled at the end.

Sends the raw frames of a drive's profile (``configs/drives``) on behalf of the supervisor of nodes
that move real drives. If the watchdog of a drive does not read back as written, the drive is not
enabled, and nothing starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.deployment.drive_sequences import Foreign, commanded_drives
from bridge.deployment.system import System
from bridge.native.bus import KIND, Accept
from bridge.native.frame import Flags, Frame
from bridge.node.buses import can_spec
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.errors import RunError

#: s a drive may take to answer.
PATIENCE = 0.5


def foreign_drives(system: System, nodes: Iterable[str]) -> tuple[Foreign, ...]:
    """The drives that these nodes send torques to by a profile, each once."""
    return tuple(d for n in nodes for d in commanded_drives(system.deployment, system.nodes[n]))


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
    for frame in drive.frames(sequence):
        end.bus.send(frame)


def _watchdog(drive: Foreign, end: Attachment) -> None:
    """Write the time-out of the watchdog and read it back, if the profile describes how."""
    own = drive.profile.watchdog
    if own.write is not None:
        end.bus.send(drive.frame(*own.write.at(drive.node, own.raw(drive.profile.timeout))))
    if own.read is None or own.reply is None:
        return
    end.bus.drain()
    end.bus.send(drive.frame(*own.read.at(drive.node)))
    answer = Accept(own.reply.at(drive.node)[0], flag_mask=KIND)
    until = monotonic_ns() + round(PATIENCE * 1e9)
    while monotonic_ns() < until:
        for frame in filter(answer.takes, end.bus.drain()):
            if own.check(drive.profile.timeout, drive.node, frame.id, frame.payload):
                return _check_format(drive, frame)
        sleep(0.005)
    raise RunError(
        f"drive {drive.node} on bus {drive.bus} did not answer with its {own.register} within "
        f"{PATIENCE:g} s ({drive.profile.path}): it is not enabled"
    )


def _check_format(drive: Foreign, frame: Frame) -> None:
    """Raise RunError if a drive answers in another format: its feedback would not be received."""
    fd = Flags.FD in Flags(frame.flags)
    if fd != (Flags.FD in drive.profile.format):
        found, expected = ("CAN FD", "classic CAN") if fd else ("classic CAN", "CAN FD")
        raise RunError(
            f"drive {drive.node} on bus {drive.bus} answers with frames of {found}, expected "
            f"{expected} ({drive.profile.path}): set its bit rate or take another profile"
        )
