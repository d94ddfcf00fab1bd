"""Settings of a simulated bus: its nodes and its disturbances."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from cosim.bus.timing import TimingError


class QueueKind(IntEnum):
    """``QUEUE_``: how a node orders what it has to send.

    FIFO: in the order of the requests (SocketCAN's default, most USB adapters). SORTED: the frame
    that wins arbitration first; equal ones by age. MAILBOXES: as SORTED, and a newer frame replaces
    the pending one of the same identifier unless that is being sent.
    """

    FIFO = 0
    SORTED = 1
    MAILBOXES = 2


class LineLevel(IntEnum):
    """``LEVEL_``: what becomes of a bit.

    INVERTED: the level that was there, inverted. DOMINANT, RECESSIVE: this level, whatever is sent.
    DISCONNECTED (of one node, in an interruption): it sees a recessive bus, no other sees its bits.
    """

    INVERTED = 0
    DOMINANT = 1
    RECESSIVE = 2
    DISCONNECTED = 3


class FrameEncoding(IntEnum):
    """``ENCODING_``: how a frame carries values, one behind the other, low byte first.

    NONE: it carries none. Integers: the nearest to value/scale, within the range of their type.
    """

    NONE = 0
    FLOAT32 = 1
    FLOAT64 = 2
    INT16 = 3
    INT32 = 4

    @property
    def size(self) -> int:
        """Bytes of a value."""
        return (0, 4, 8, 2, 4)[self]


@dataclass(frozen=True, slots=True)
class AcceptanceFilter:
    """Accepts frames whose identifier equals `identifier` under `mask`; `extended` None: both."""

    identifier: int
    mask: int = 0x1FFFFFFF
    extended: bool | None = None


@dataclass(frozen=True, slots=True)
class BusNodeSettings:
    """A node of a bus.

    `queue_length`: frames that can wait for transmission; a request beyond is dropped.
    `one_shot`: no second attempt after an error or a lost arbitration. `filters`: a frame that
    passes one of them is received; without filters, all are. `receive_length`: frames of the
    receive FIFO, 0: RECEIVED events only. `recovers`: goes back on the bus after bus-off by itself,
    otherwise after `SimulatedBus.reset`. `inbox`: requests that may lie in the future at a time.
    `tec`, `rec`: the error counters at time 0; a TEC of 256 means bus-off, from time 0 on.
    `clock_ppm`: how much faster than nominal the node's clock is, parts per million; the node that
    transmits times the bus, and a receiver follows as far as its bit timing allows: `sample_point`,
    and `sjw` (synchronisation jump width: the most that one edge corrects), as shares of a bit.
    """

    name: str
    queue: QueueKind = QueueKind.SORTED
    queue_length: int = 64
    one_shot: bool = False
    filters: tuple[AcceptanceFilter, ...] = ()
    receive_length: int = 0
    recovers: bool = True
    inbox: int = 1024
    tec: int = 0
    rec: int = 0
    clock_ppm: float = 0.0
    sample_point: float = 0.875
    sjw: float = 0.125

    def __post_init__(self) -> None:
        bounds = (("clock_ppm", -200_000, 200_000), ("sample_point", 0.01, 0.99), ("sjw", 0, 0.5))
        for name, low, high in bounds:
            if not low <= getattr(self, name) <= high:
                raise TimingError(
                    f"node {self.name}: found {name} = {getattr(self, name)},"
                    f" expected {low} to {high}"
                )
        for name, most in (("tec", 256), ("rec", 255)):
            if not 0 <= getattr(self, name) <= most:
                raise TimingError(
                    f"node {self.name}: found {name} = {getattr(self, name)}, expected 0 to {most}"
                )
        for name, least in (("queue_length", 1), ("receive_length", 0), ("inbox", 1)):
            found = getattr(self, name)
            if not least <= found <= 65535:
                raise TimingError(
                    f"node {self.name}: found {name} = {found}, expected {least} to 65535 frames"
                )


@dataclass(frozen=True, slots=True)
class ScriptedError:
    """Bits `bit` ... `bit + length - 1` of the `attempt`-th attempt to send an identifier.

    Bits count from the start of frame (0), stuff bits included; those behind the frame count, too,
    up to the next start. Attempts count from 1; 0: each. An attempt is a start of frame in which
    the identifier has the highest priority. `node` None: the bus itself, for all nodes.
    """

    identifier: int
    bit: int
    attempt: int = 1
    length: int = 1
    extended: bool = False
    node: int | None = None
    level: LineLevel = LineLevel.INVERTED


@dataclass(frozen=True, slots=True)
class ErrorRate:
    """Bits inverted at random, each with probability `rate`, while the bus is busy.

    `length`: bits in a row each time (a burst). Busy is from a start of frame until all nodes have
    seen the intermission. `node` None: the bus itself, for all nodes.
    """

    rate: float
    length: int = 1
    node: int | None = None


@dataclass(frozen=True, slots=True)
class Interruption:
    """All bits that begin from `start_ps` to before `end_ps`; of one node or of the bus (None)."""

    start_ps: int
    end_ps: int
    level: LineLevel = LineLevel.RECESSIVE
    node: int | None = None


Disturbance = ScriptedError | ErrorRate | Interruption
