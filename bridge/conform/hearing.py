"""Frames that a participant has sent, each with its time, decoded, in the order of arrival."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import final

from bridge.can.codec import Codec
from bridge.conform.lines import frame_key
from bridge.deployment.system import System
from bridge.native.enums import LifeState, Status
from bridge.native.frame import Flags, Frame
from bridge.native.message import Decoded, carries_state, is_preview
from cosim.base.clock import monotonic_ns

_STATE = 7
_FORMAT = Flags.FD | Flags.REMOTE | Flags.EXTENDED


class Heard(StrEnum):
    """The kind of a frame of the participant."""

    SAMPLE = "sample"
    HEARTBEAT = "heartbeat"
    ESTOP = "ESTOP"
    EPOCH = "EPOCH"
    NMT = "NMT"
    SYNC = "SYNC"
    FOREIGN = "foreign"


@dataclass(frozen=True, slots=True)
class HeardFrame:
    """A frame of the participant. `values` are those of its message, () unless `result` is OK."""

    index: int
    t_ns: int
    bus: str
    kind: Heard
    name: str
    frame: Frame
    result: Decoded
    values: tuple[float, ...]
    counter: int
    status: int
    t_us: int

    @property
    def state(self) -> LifeState | None:
        """The life cycle that it tells; None: it tells none."""
        if self.result is not Decoded.OK:
            return None
        code = int(self.values[0]) if self.kind is Heard.HEARTBEAT else self.status & _STATE
        return LifeState(code) if code in list(LifeState) else None

    @property
    def state_name(self) -> str:
        """The life cycle that it tells, in capitals."""
        return "no state" if self.state is None else self.state.name

    @property
    def reasons(self) -> int:
        """The latched reasons of a heartbeat."""
        return int(self.values[1]) if self.kind is Heard.HEARTBEAT and self.values else 0

    @property
    def armed(self) -> bool:
        """True if the heartbeat says armed."""
        return self.kind is Heard.HEARTBEAT and bool(self.values) and self.values[3] != 0.0

    def text(self) -> str:
        """For people: identifier and bytes."""
        flags = Flags(self.frame.flags)
        kind = "FD " if flags & Flags.FD else "remote " if flags & Flags.REMOTE else ""
        data = "" if flags & Flags.REMOTE else self.frame.payload.hex(" ")
        return f"{self.name or 'a frame'} {kind}{self.frame.id:#05x} [{self.frame.length}] {data}"


@dataclass(frozen=True, slots=True)
class KnownMessage:
    """A message that a participant may send on a bus."""

    kind: Heard
    name: str
    codec: Codec


@final
class Hearing:
    """The frames of the participant."""

    def __init__(self, system: System, node: str) -> None:
        self._known: dict[tuple[str, int], KnownMessage] = {}
        self._frames: list[HeardFrame] = []
        self._more = threading.Condition()
        number = system.deployment.nodes[node].number
        for name, carried in system.messages.items():
            if carried.node == node:
                self._learn(carried.bus, Heard.SAMPLE, name, carried.encoding)
        for bus in system.buses_of(node):
            service = system.services[bus]
            self._learn(bus, Heard.HEARTBEAT, "heartbeat", service.heartbeats.get(number))
            self._learn(bus, Heard.ESTOP, "ESTOP", service.estop)
            self._learn(bus, Heard.EPOCH, "EPOCH", service.epoch)
            if system.deployment.sync == node:
                self._learn(bus, Heard.SYNC, "SYNC", service.sync)
            if system.nodes[node].forwards:
                self._learn(bus, Heard.NMT, "NMT", service.nmt)

    def _learn(self, bus: str, kind: Heard, name: str, encoding: object) -> None:
        if isinstance(encoding, Codec):
            self._known[bus, int(encoding.message.id)] = KnownMessage(kind, name, encoding)

    def known(self, kind: Heard) -> dict[str, KnownMessage]:
        """Messages of a kind, by ``BUS/NAME``."""
        return {f"{bus}/{m.name}": m for (bus, _), m in self._known.items() if m.kind is kind}

    def arrived(self, bus: str, frame: Frame, t_ns: int) -> None:
        """Keep a frame. Called by the threads of the buses."""
        with self._more:
            self._frames.append(self._decoded(len(self._frames), bus, frame, t_ns))
            self._more.notify_all()

    def _decoded(self, index: int, bus: str, frame: Frame, t_ns: int) -> HeardFrame:
        known = self._known.get((bus, int(frame.id)))
        wanted = 0 if known is None else int(known.codec.message.flags) & _FORMAT
        if known is None or frame.flags & _FORMAT != wanted:
            name = known.name if known else ""
            kind = Heard.FOREIGN
            return HeardFrame(index, t_ns, bus, kind, name, frame, Decoded.LENGTH, (), 0, 0, 0)
        result, values, header = known.codec.decode(frame.payload)
        found = tuple(values.tolist()) if result is Decoded.OK else ()
        return HeardFrame(
            index, t_ns, bus, known.kind, known.name, frame, result, found,
            int(header.counter), int(header.status), int(header.t_us),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self._frames)

    def since(self, index: int, kind: Heard | None = None) -> list[HeardFrame]:
        """Frames from number `index` on, of a kind."""
        with self._more:
            found = self._frames[index:]
        return [f for f in found if kind is None or f.kind is kind]

    def wait(
        self, fits: Callable[[HeardFrame], bool], index: int, seconds: float
    ) -> HeardFrame | None:
        """The first frame from number `index` on that fits; None: none within `seconds` (s)."""
        end_ns = monotonic_ns() + round(seconds * 1e9)
        while True:
            with self._more:
                new = self._frames[index:]
                if not new:
                    left = (end_ns - monotonic_ns()) / 1e9
                    if left <= 0:
                        return None
                    self._more.wait(min(left, 0.1))
                    continue
            for frame in new:
                if fits(frame):
                    return frame
            index += len(new)

    def latest_beat(self) -> HeardFrame | None:
        """The newest heartbeat that is readable."""
        return next(self._backwards(lambda f: f.kind is Heard.HEARTBEAT and bool(f.values)), None)

    def _backwards(self, fits: Callable[[HeardFrame], bool]) -> Iterator[HeardFrame]:
        with self._more:
            found = list(reversed(self._frames))
        return (f for f in found if fits(f))

    def tells_state(self, name: str) -> bool:
        """True if samples of this message carry the life cycle."""
        found = [m for m in self.known(Heard.SAMPLE).values() if m.name == name]
        return bool(found) and carries_state(found[0].codec.message)

    def is_preview(self, heard: HeardFrame) -> bool:
        """True if it is a sample of a participant that waits for its start."""
        known = self._known[heard.bus, int(heard.frame.id)]
        return is_preview(known.codec.message, heard.status)


def is_same(a: HeardFrame, b: HeardFrame) -> bool:
    """True if both are the same bytes."""
    return frame_key(a.frame) == frame_key(b.frame)


def has_status(heard: HeardFrame, bit: Status) -> bool:
    """True if a readable frame has this bit of the status."""
    return heard.result is Decoded.OK and bool(heard.status & bit)
