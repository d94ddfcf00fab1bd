"""Checkpoints of a run in lock-step: instants that all nodes reach before any passes them.

No sample is on its way at such an instant, so the states that the nodes save there fit together. A
node writes state N + 1 only after all have written state N, and keeps both: so there is a number
that all of them have, whenever and wherever they are killed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import final

from bridge.deployment.system import System
from bridge.node.checkpoints import numbers, place
from bridge.node.handle import NodeHandle
from bridge.records.node_lives import Life
from cosim.base.clock import sleep, stopwatch
from cosim.checkpoint import archive

#: Instants in an interval between two checkpoints, and the wall time between two, s.
INSTANTS, SHORTEST, LONGEST = 4, 0.05, 5.0
#: The least slots between two instants, and how much longer than the last stretch the next may be.
FIRST, LONGER = 16, 4.0
#: s to wait for a checkpoint when a run is interrupted.
PATIENCE = 20.0
LOOK = 0.01


@dataclass(frozen=True, slots=True)
class Keeping:
    """The checkpoints of a run: `interval`, s of wall time between two of them.

    `resumes`: the number of the checkpoint that it begins with, at `t_ns`; -1: at its start.
    """

    interval: float
    resumes: int = -1
    t_ns: int = 0


def last_number(system: System, nodes: Path) -> tuple[int, int] | None:
    """The last checkpoint that all nodes have, and its time, ns; None: there is none.

    `nodes`: the folder of their journals. Raises ScenarioError.
    """
    places = [place(nodes, Life(name)) for name in system.nodes]
    known = [numbers(folder) for folder in places]
    common = set(known[0]).intersection(*known[1:])
    if not common:
        return None
    number = max(common)
    return number, int(archive.read(places[0] / known[0][number]).facts["t_ns"])


@final
class RunCheckpoints:
    """The instants of one run, and the checkpoints at some of them; `slot_ns`: its longest slot."""

    def __init__(self, keeping: Keeping, slot_ns: int) -> None:
        self._keeping, self._number = keeping, keeping.resumes
        self._until, self._least = keeping.t_ns, FIRST * slot_ns
        self._stretch = self._least
        self._since = self._left = stopwatch()
        self._begun = self._saves = False

    @property
    def t(self) -> float:
        """The instant that all nodes have reached last or reach next, s."""
        return self._until * 1e-9

    def look(self, nodes: Mapping[str, NodeHandle]) -> None:
        """If all nodes stand at the instant, save their states if it is time, and let them go."""
        there = self._all_there(nodes)
        if self._saves and all(node.saved >= self._number for node in nodes.values()):
            self._saves, self._left = False, stopwatch()
        if not there:
            return
        due = self._since() >= self._keeping.interval if self._begun else self._number < 0
        save = self._saves = due and not any(node.done for node in nodes.values())
        if save:
            self._number += 1
        if save or not self._begun:
            self._since = stopwatch()
        self._stretch = self._next_stretch()
        self._begun, self._left = True, stopwatch()
        self._go(nodes, self._until + self._stretch, save=save)

    def save_last(self, nodes: Mapping[str, NodeHandle]) -> bool:
        """Save the states at the next instant, before the nodes are stopped; false: not possible,
        since a node has ended or is too slow.
        """
        elapsed = stopwatch()
        number, at = self._number + 1, self._until
        while any(node.saved < number for node in nodes.values()):
            if self._all_there(nodes) and self._number < number:
                self._number = number
                self._go(nodes, at, save=True)
            if elapsed() > PATIENCE or any(node.code is not None for node in nodes.values()):
                return False
            sleep(LOOK)
        return True

    def _all_there(self, nodes: Mapping[str, NodeHandle]) -> bool:
        for node in nodes.values():
            node.poll()
        running = [node for node in nodes.values() if not node.done]
        return bool(running) and all(node.reached >= self._until for node in running)

    def _next_stretch(self) -> int:
        """The time to the next instant, ns, by the speed of the last stretch without the saving."""
        if not self._begun:
            return self._stretch
        wanted = min(max(self._keeping.interval / INSTANTS, SHORTEST), LONGEST)
        longer = min(wanted / max(self._left(), 1e-6), LONGER)
        return max(round(self._stretch * longer), self._least)

    def _go(self, nodes: Mapping[str, NodeHandle], until: int, *, save: bool) -> None:
        self._until = until
        for node in nodes.values():
            node.send_command("go", until_ns=until, save=self._number if save else -1)
