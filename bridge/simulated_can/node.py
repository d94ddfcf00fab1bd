"""A node of a simulated wire, what happens to it, and who is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cosim.bus.frames import EVENT, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings


@dataclass(eq=False)
class WireNode:
    """A node, as the wire sees it. `pending`: by number of the request, in their order."""

    settings: BusNodeSettings
    pending: dict[int, BusFrame] = field(default_factory=dict)
    tec: int = 0
    rec: int = 0
    state: ControllerState = ControllerState.ACTIVE
    leaving: bool = False
    """Sends what it has, receives nothing more."""

    @property
    def recovering(self) -> bool:
        """True if it comes back to the bus by itself."""
        off = self.state == ControllerState.OFF or self.state == ControllerState.INTEGRATING
        return off and self.settings.recovers


#: An event of the bus at one node: its time (ps since the wire exists), the node, kind, code, role,
#: bit (from 0) and frame of the event.
Happening: TypeAlias = tuple[int, WireNode, int, int, int, int, BusFrame | None]


class WireRecorder(Protocol):
    """A record of what happens; the numbers of nodes and requests never change."""

    def node(self, name: str) -> int:
        """The number of a node that has joined."""

    def request(self, number: int, at_ps: int, node: int, frame: BusFrame) -> None:
        """A request; numbers rise."""

    def add(self, events: NDArray[np.void], until_ps: int) -> None:
        """Events up to `until_ps` (ps), rows of ``cosim.bus.frames.EVENT``, shape (n,)."""


def told(
    events: Sequence[tuple[int, ...]],
    start_ps: int,
    nodes: Sequence[int],
    numbers: Mapping[int, int],
) -> NDArray[np.void]:
    """Events of a bus that began at `start_ps` (ps), as a recorder has them: ``EVENT``, shape (n,).

    `events`: tuples with the fields of ``EVENT``. `nodes`, `numbers`: those of the recorder, for
    each node and each request of that bus.
    """
    rows = np.array(events, EVENT)
    if len(rows):
        rows["time"] += start_ps
        rows["frame"] = -1
        rows["node"] = np.array([*nodes, -1], np.int16)[rows["node"]]
        rows["request"] = [numbers.get(event[1], -1) for event in events]
    return rows
