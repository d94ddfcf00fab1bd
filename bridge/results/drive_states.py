"""Real drives that told their state more seldom than their profile says.

A node hears that a drive has tripped when the drive tells so, and sends it torques until then.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from bridge.deployment.drive_sequences import Foreign, commanded_drives, drive_names
from bridge.deployment.system import System
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.records.node_lives import Life, frame_files

#: Times of `every` of a profile after which a state is late; the frames of a bus wait at times.
LATE = 3.0


def seldom_told(system: System, lives: Iterable[Life], nodes: Path) -> Iterator[str]:
    """A sentence for the drives of each bus whose states came too seldom, with the usual time.

    `nodes`: the folder with the logs of the buses of each life.
    """
    for life in lives:
        found: dict[tuple[str, str], list[int]] = {}
        for drive in commanded_drives(system.deployment, system.nodes[life.node]):
            status, path = drive.profile.status, frame_files(nodes, drive.bus).get(life)
            usual = _usual(drive, path) if status.every and path else 0.0
            if usual > LATE * status.every > 0:
                about = (
                    f"every {usual * 1e3:.0f} ms, expected {status.every * 1e3:g} ms"
                    f" ({status.register or drive.profile.path}): for so long torques are sent"
                    " to one that has tripped"
                )
                found.setdefault((drive.bus, about), []).append(drive.node)
        for (bus, about), numbers in found.items():
            yield f"{life}: {drive_names(numbers, bus)} told its state {about}"


def _usual(drive: Foreign, path: Path) -> float:
    """The median time between two states of a drive, s; 0: there are not two."""
    log = Journal.open(path)
    told = log["t_ns"][drive.status.among(log) & (log["flags"] & Flags.SENT == 0)]
    return float(np.median(np.diff(told))) * 1e-9 if len(told) > 1 else 0.0
