"""Settings and results of a rehearsal; :mod:`bridge.rehearsal.supervisor` runs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from bridge.faults.script import FaultEvent
from bridge.node.handle import NodeHandle, NodeStart, SlotImage
from bridge.records.records import Note
from bridge.rehearsal.checkpoints import Keeping

OnHost = Callable[[str], AbstractContextManager[None]]


class NodeStarter(Protocol):
    """Other hosts, on which it starts nodes; entered with a rehearsal, and left at its end."""

    def __enter__(self) -> object: ...

    def __exit__(self, *raised: object) -> None: ...

    def start_node(self, start: NodeStart) -> NodeHandle:
        """Start a life of a node on its host."""
        ...


@dataclass(frozen=True, slots=True)
class ScheduledEvent:
    """Something done at `t` (s): `action` is called with the Rehearsal that runs.

    `what`: for its notes, see :mod:`bridge.faults.load`.

    `restarts_node`: it starts a node again, so that a run in which no node is left waits for it.
    `prepare`: starts, while the nodes start, what takes a while to begin; the function it returns
    waits until that is ready.
    """

    t: float
    what: str | FaultEvent
    action: Callable[[Any], None]
    restarts_node: bool = False
    prepare: Callable[[Any], Callable[[], None]] | None = None

    @property
    def sets_interface(self) -> bool:
        """True if another process carries it out, which takes a while on a busy machine: it has
        happened when `action` returns, not when `action` is called.
        """
        return isinstance(self.what, FaultEvent) and self.what.action in ("bus-down", "bus-up")


@dataclass(frozen=True, slots=True)
class Settings:
    """The settings of a rehearsal; `real`: its nodes may move real drives.

    `say`: called with a sentence at each step of a run with real drives; `images`: by node, those
    that compute the slots of nodes.
    """

    scenario: Path
    deployment: Path
    changes: tuple[str, ...] = ()
    warm_up: float = 0.2
    realtime: bool = True
    real: bool = False
    script: str = ""
    events: Sequence[ScheduledEvent] = ()
    nodes: tuple[str, ...] = ()  # those started here; empty: all
    outside: Mapping[str, str] = field(default_factory=dict)  # commands of other nodes' programs
    on_host: OnHost = lambda node: nullcontext()  # the host a node's process is started on
    starter: NodeStarter | None = None  # of all nodes; None: processes of this host
    say: Callable[[str], None] = lambda text: None
    images: Mapping[str, SlotImage] = field(default_factory=dict)
    keeping: Keeping | None = None  # checkpoints, in lock-step


@dataclass(slots=True)
class RehearsalRecord:
    """The result of a rehearsal: lives in the order of their start, and notes."""

    lives: list[NodeHandle] = field(default_factory=list)
    notes: list[Note] = field(default_factory=list)
    start_ns: int = 0
    interrupted: bool = False
