"""Drives with their own protocols are disabled once more when all nodes have ended.

A node brings its drives up and disables them itself (``bridge/c/bringup.c``); the frames sent here
reach those of a node that was killed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.deployment.drive_sequences import Foreign, commanded_drives
from bridge.deployment.system import System
from bridge.node.buses import can_spec


def foreign_drives(system: System, nodes: Iterable[str]) -> tuple[Foreign, ...]:
    """The drives that these nodes send torques to by a profile, each once."""
    return tuple(d for n in nodes for d in commanded_drives(system.deployment, system.nodes[n]))


@contextmanager
def disabled_at_the_end(system: System, nodes: Iterable[str]) -> Iterator[tuple[Foreign, ...]]:
    """All foreign drives of these nodes, which are disabled at the end whatever happens."""
    drives = foreign_drives(system, tuple(nodes))
    with ExitStack() as stack:
        ends: dict[str, Attachment] = {}
        for bus in {drive.bus for drive in drives}:
            ends[bus] = interface.attach(can_spec(system.deployment, bus))
            stack.callback(ends[bus].close)
        for drive in drives:
            stack.callback(_disable, drive, ends[drive.bus])
        yield drives


def _disable(drive: Foreign, end: Attachment) -> None:
    for frame in drive.frames("disable"):
        end.bus.send(frame)
