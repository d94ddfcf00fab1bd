"""The messages of a bus as plain data, and what follows from them: load and response times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from bridge.can.layout import MessageLayout
from bridge.can.load import Share, kind_of, planned_load
from bridge.native.frame import Flags
from cosim.bus.arbitration import rank
from cosim.bus.response import FrameStream, Response, responses
from cosim.bus.settings import QueueKind
from cosim.bus.timing import BusTiming, FrameFormat, worst

Role = Literal["data", "nmt", "sync", "emergency", "time", "sdo", "heartbeat", "drive"]
#: Stands for a message that has no period: it comes once in any busy period. ns
ONCE = 3_600_000_000_000


@dataclass(frozen=True, slots=True)
class SignalRange:
    """A signal: from `low` to `high` by the scenario's limits, `least` to `most` by its field."""

    name: str
    low: float
    high: float
    least: float
    most: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BusMessage:
    """A message as its sender queues it; times in s, `length` in bytes.

    `period` None: on events, at most once while others wait. `jitter`: how late it may be queued.
    `deadline`: default the period. `offset` is not used: see :mod:`cosim.bus.response`. `queue`: of
    its node on this bus; all messages of a node and bus have the same.
    """

    name: str
    identifier: int
    length: int
    period: float | None
    node: str
    bus: str
    extended: bool = False
    fd: bool = False
    brs: bool = False
    offset: float = 0.0
    jitter: float = 0.0
    deadline: float | None = None
    role: Role = "data"
    signals: tuple[SignalRange, ...] = ()
    queue: QueueKind = QueueKind.SORTED

    @classmethod
    def of(
        cls,
        layout: MessageLayout,
        *,
        node: str,
        bus: str,
        period: float | None = None,
        role: Role = "data",
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> BusMessage:
        """A message of a DBC file, with `period` (s) instead of its own and `limits` of signals by
        name.
        """
        flags = Flags(layout.flags)
        return cls(
            name=layout.name,
            identifier=layout.identifier,
            length=layout.length,
            period=layout.period if period is None else period,
            node=node,
            bus=bus,
            extended=bool(flags & Flags.EXTENDED),
            fd=bool(flags & Flags.FD),
            brs=bool(flags & Flags.BRS),
            role=role,
            signals=ranges(layout, limits or {}),
        )

    @property
    def kind(self) -> FrameFormat:
        """The format of its frames."""
        flags = Flags.EXTENDED * self.extended | Flags.FD * self.fd | Flags.BRS * self.brs
        return kind_of(flags)

    @property
    def place(self) -> str:
        """Name and identifier."""
        return f"{self.name} ({self.identifier:#05x})"


def ranges(
    layout: MessageLayout, limits: Mapping[str, tuple[float, float]]
) -> tuple[SignalRange, ...]:
    """Limits of signals: `limits` (in the unit of each signal) within the range of their fields.

    Raises LayoutError for a limit of a signal that does not exist.
    """
    found = []
    for name, (low, high) in limits.items():
        signal = layout.signal(name)
        ends = sorted(signal.scale * raw + signal.offset for raw in signal.raw_range)
        found.append(SignalRange(name, low, high, ends[0], ends[1]))
    return tuple(found)


def bus_share(messages: Iterable[BusMessage], timing: BusTiming) -> Share:
    """Load of one bus by its periodic messages, 1 = always busy."""
    return planned_load([(m.length, m.kind, m.period) for m in messages if m.period], timing)


def bus_responses(
    messages: Sequence[BusMessage], timing: BusTiming
) -> list[tuple[BusMessage, Response]]:
    """Worst-case response times on one bus, most urgent first, with worst-case frames.

    Raises TimingError where two messages have one identifier.
    """
    owner = {rank(m.identifier, m.extended): m for m in messages}
    streams = [
        FrameStream(
            m.name,
            rank(m.identifier, m.extended),
            round(m.period * 1e9) if m.period else ONCE,
            timing.time_ns(worst(m.length, m.kind)),
            round(m.jitter * 1e9),
            None if m.deadline is None else round(m.deadline * 1e9),
            m.node if m.queue == QueueKind.FIFO else "",
        )
        for m in messages
    ]
    return [(owner[r.stream.rank], r) for r in responses(streams, timing.bit_ns)]
