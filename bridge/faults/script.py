"""A fault script prepared for execution: rules for C, and events for a supervisor.

Faults of frames act where a node receives (``bridge/c/faults.h``): :meth:`FaultScript.frames_for`.
Faults of processes and buses are a list of events that the supervisor of the nodes carries out:
:meth:`FaultScript.process_events`. Times count from the start of the run.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from hashlib import sha256
from math import isinf
from pathlib import Path
from typing import Any, Literal

from bridge.can.repeated_frame import EXTENDED
from bridge.deployment.carried import Subscription
from bridge.native import faults as native
from bridge.native.bus import Accept
from bridge.native.faults import Fault, Injector
from bridge.native.frame import Flags
from bridge.native.message import Message
from bridge.native.vendor import VendorFault
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.names import unknown

Action = Literal[
    "kill", "start", "freeze", "thaw", "noise", "clock-jump",
    "bus-down", "bus-up", "babble", "hush",
    "net-down", "net-delay", "net-loss", "net-rate", "net-over",
]  # fmt: skip
OF_BUSES = ("bus-down", "bus-up", "babble", "hush")
OF_LINKS = ("net-down", "net-delay", "net-loss", "net-rate", "net-over")
KINDS = {
    "drop": native.DROP,
    "sync-loss": native.DROP,
    "burst": native.BURST,
    "delay": native.DELAY,
    "jitter": native.JITTER,
    "duplicate": native.DUPLICATE,
    "reorder": native.REORDER,
    "corrupt": native.CORRUPT,
    "forge": native.FORGE,
    "replay": native.REPLAY,
    "absurd": native.ABSURD,
    "flood": native.FLOOD,
}
#: Faults by a peer that knows the format of a message: only for messages of the deployment.
HOSTILE = ("forge", "replay", "absurd", "flood")


@dataclass(frozen=True, slots=True)
class FrameFault:
    """A fault of frames; `index`: of its table, `t0`, `t1`: s, `a`, `b`: smallest and greatest (s).

    `nodes`: receivers; `messages`: patterns of names, or identifiers; `bus`: "" for all.
    """

    index: int
    kind: str
    nodes: tuple[str, ...]
    messages: tuple[str | int, ...]
    bus: str
    t0: float
    t1: float
    probability: float
    count: int
    a: float
    b: float

    def about(self, listened: Iterable[Subscription]) -> list[Subscription]:
        """The subscriptions of a node that this fault touches."""
        return [one for one in listened if self.bus in ("", one.bus) and self._names(one)]

    def _names(self, one: Subscription) -> bool:
        return any(
            fnmatchcase(one.name, m)
            if isinstance(m, str)
            else _same_identifier(_numbered(m), one.accept)
            for m in self.messages
        )


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """Something to be done to a process or a bus `t` s after the start; `index`: of its table.

    `target`: a node, a bus or a link of the network. `id`, `rate` (frames/s), `length` (bytes): of
    a babbling peer, `length` also of noise; `by`: s, of a clock that jumps; `spec`: what a link of
    the network is like.
    """

    t: float
    action: Action
    target: str
    index: int
    id: int = 0
    rate: float = 0.0
    length: int = 0
    by: float = 0.0
    spec: Mapping[str, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The fault as a rehearsal notes it."""
        return f"{self.action} {self.target}"


@dataclass(frozen=True, slots=True)
class DriveFault:
    """Something that happens to an emulated drive `t` s after the start; `index`: of its table."""

    index: int
    t: float
    bus: str
    drive: int
    fault: VendorFault
    code: int


@dataclass(frozen=True, slots=True)
class NodeFaults:
    """The rules of one node, ready for C: `indices[i]` is the table that rule i comes from."""

    injector: Injector
    indices: tuple[int, ...]

    def hits(self) -> dict[int, int]:
        """Frames each table did something to here, by its index."""
        found = dict.fromkeys(self.indices, 0)
        for index, hits in zip(self.indices, self.injector.hits(), strict=True):
            found[index] += hits
        return found


@dataclass(frozen=True, slots=True)
class FaultScript:
    """A script, as :func:`bridge.faults.load.load` reads it."""

    path: Path
    title: str
    seed: int
    frames: tuple[FrameFault, ...]
    events: tuple[FaultEvent, ...]
    drives: tuple[DriveFault, ...] = ()

    def place(self, index: int, key: str) -> str:
        """The place of a value in the file: ``FILE at fault.0.node``."""
        return f"{self.path} at fault.{index}.{key}"

    def frames_for(
        self,
        node: str,
        listened: Sequence[Subscription],
        buses: Mapping[str, int] | None = None,
        *,
        samples: Mapping[str, Message] | None = None,
        journal: int | None = None,
        capacity: int = 4096,
    ) -> NodeFaults | None:
        """Faults of frames as `node` receives them; None: there are none.

        `listened`: what it hears, SYNC among it; `buses`: their numbers in the node; `samples`:
        the messages of the deployment among them, by name, which a hostile peer can make (they
        have to live as long as this); `journal`: address of a journal of INJECTED rows;
        `capacity`: frames that wait at once. What the node does not know is passed over; see
        :meth:`check`.
        """
        numbers = buses or {}
        rules, indices = [], []
        for fault in self.frames:
            if not _named(node, fault.nodes) or (fault.bus and fault.bus not in numbers):
                continue
            for label, bus, accept, sample in _matching(fault, listened, samples or {}):
                rule = _rule(fault, accept, self._random(fault, node, label))
                rule.bus = numbers.get(bus, -1)
                if sample is not None:
                    rule.message = c.pointer(sample)
                rules.append(rule)
                indices.append(fault.index)
        if not rules:
            return None
        return NodeFaults(Injector(rules, capacity, journal), tuple(indices))

    def process_events(
        self, nodes: Sequence[str] = (), buses: Sequence[str] = ()
    ) -> tuple[FaultEvent, ...]:
        """Events in the order of time; ``"*"`` is replaced by each of `nodes` or `buses`."""
        found: list[FaultEvent] = []
        for event in self.events:
            if event.action in OF_LINKS:
                found.append(event)
                continue
            every = buses if event.action in OF_BUSES else nodes
            targets = every if event.target == "*" else (event.target,)
            found += [replace(event, target=target) for target in targets]
        return tuple(sorted(found, key=lambda e: (e.t, e.index, e.target)))

    def check(self, nodes: Sequence[str], buses: Sequence[str], messages: Sequence[str]) -> None:
        """Refuse names that are none of these. Raises ScenarioError naming the place."""
        for fault in self.frames:
            for node in fault.nodes:
                _known(node, nodes, "node", self.place(fault.index, "node"))
            for message in fault.messages:
                if isinstance(message, str):
                    _known(message, messages, "message", self.place(fault.index, "message"))
            if fault.bus:
                _known(fault.bus, buses, "bus", self.place(fault.index, "bus"))
        for one in self.drives:
            _known(one.bus, buses, "bus", self.place(one.index, "bus"))
        for event in (e for e in self.events if e.action not in OF_LINKS):
            what, names = ("bus", buses) if event.action in OF_BUSES else ("node", nodes)
            _known(event.target, names, what, self.place(event.index, what))

    def _random(self, fault: FrameFault, node: str, message: str) -> int:
        """The state a rule's generator starts from, by seed, table, node and message."""
        text = f"{self.seed}\0{fault.index}\0{node}\0{message}"
        return int.from_bytes(sha256(text.encode()).digest()[:8], "little")


def _named(node: str, nodes: Sequence[str]) -> bool:
    return "*" in nodes or node in nodes


def _numbered(number: int) -> Accept:
    """Data frames with an identifier of a script, classic or CAN FD."""
    long = number > 0x7FF  # with EXTENDED, too
    return Accept(number & ~EXTENDED, flags=Flags.EXTENDED if long else 0)


def _same_identifier(a: Accept, b: Accept) -> bool:
    """True if two are of one identifier, of 11 or 29 bits."""
    return a.id == b.id and not (a.flags ^ b.flags) & Flags.EXTENDED


_Match = tuple[str, str, Accept, Message | None]


def _matching(
    fault: FrameFault, listened: Sequence[Subscription], samples: Mapping[str, Message]
) -> Iterator[_Match]:
    """Label, bus ("": all), frames and message (for hostile peers) of every rule, each once.

    A hostile peer needs a message in `samples`. A number that belongs to no message is used as it
    is.
    """
    hostile = fault.kind in HOSTILE
    if "*" in fault.messages and not hostile:
        yield "*", fault.bus, Accept(0, 0, 0, 0), None
        return
    found = [one for one in fault.about(listened) if not hostile or one.name in samples]
    labels: set[str] = set()
    for one in sorted(found, key=lambda one: one.name):
        label = f"{one.name}\0{one.bus}" if one.name in labels else one.name
        labels.add(one.name)
        yield label, one.bus, one.accept, samples.get(one.name) if hostile else None
    for number in (m for m in fault.messages if isinstance(m, int) and not hostile):
        accept = _numbered(number)
        if not any(_same_identifier(accept, one.accept) for one in found):
            yield f"{number:#x}", fault.bus, accept, None


def _rule(fault: FrameFault, accept: Accept, random: int) -> Fault:
    return Fault(
        kind=KINDS[fault.kind],
        count=fault.count,
        t0_ns=round(fault.t0 * 1e9),
        t1_ns=native.FOREVER if isinf(fault.t1) else round(fault.t1 * 1e9),
        accept=accept,
        probability=fault.probability,
        a=fault.a,
        b=fault.b,
        random=random,
    )


def _known(name: str, names: Sequence[str], what: str, place: str) -> None:
    if any(fnmatchcase(n, name) for n in names):
        return
    raise ScenarioError(unknown(name, names, what), place)
