"""What the CAN buses of a deployment say of its nodes, to somebody who only listens.

Nothing is sent (a CAN controller still acknowledges frames, unless its interface is set to listen
only). Heartbeats tell the state of a node; messages tell values, and losses by their counters.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Self, final

import numpy as np
from numpy.typing import NDArray

from bridge.attach import can_spec
from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.native import message as native
from bridge.native.frame import Frame
from bridge.native.message import Decoded, Header, Message, Profile, Receiver
from bridge.native.safety import State, Status
from bridge.safety import explain, names
from bridge.shown import Table, View
from bridge.system import System
from cosim.errors import ScenarioError

#: What is counted is that of the last second, ns.
SPAN_NS = 10**9
_LIFE = 7  # bits of a status byte with the sender's state


@dataclass(slots=True)
class Beat:
    """The last heartbeat of a node; `t_ns`: its arrival, monotonic, -1: none yet."""

    message: Message
    t_ns: int = -1
    state: str = ""
    reasons: str = ""
    boots: int = 0
    armed: bool = False


@dataclass(slots=True)
class Heard:
    """A message: its newest values, NaN before any, and arrivals of the last second, ns."""

    name: str
    node: str
    message: Message
    receiver: Receiver
    values: NDArray[np.float64]
    times: deque[int] = field(default_factory=deque)
    status: int = 0
    refused: int = 0
    t_ns: int = -1

    @property
    def lost(self) -> int:
        """By its counter, since the listener came; without one: 0."""
        return int(self.receiver.lost)

    def take(self, frame: Frame) -> None:
        """A frame of it: values, status and counter."""
        header = Header()
        found = native.decode(self.message, frame, self.values.ctypes.data, header)
        if found not in (Decoded.OK, Decoded.INVALID):
            self.refused += 1
            return
        t = int(frame.t_ns)
        if self.message.e2e:
            gone = 0 if self.t_ns < 0 else round((t - self.t_ns) / self.receiver.period_ns)
            self.receiver.accept(header.counter, t, max(0, int(self.receiver.sequence)) + gone)
        self.status, self.t_ns = int(header.status), t
        self.times.append(t)


@final
class Listener:
    """All CAN buses of a system, open for reading. Raises BusError where one cannot be opened."""

    def __init__(self, system: System) -> None:
        self.system = system
        buses = {n: b for n, b in system.deployment.buses.items() if b.kind == "can"}
        if not buses:
            raise ScenarioError(
                "no CAN bus in this deployment to listen to", str(system.deployment.path)
            )
        self.beats: dict[str, Beat] = {}
        self.heard: dict[str, Heard] = {}
        self._by_bus: dict[str, dict[int, Beat | Heard]] = {name: {} for name in buses}
        self.unknown: dict[str, int] = dict.fromkeys(buses, 0)
        for name in buses:
            self._expect(name)
        self._stack = ExitStack()
        self.attached: dict[str, Attachment] = {}
        try:
            for number, name in enumerate(buses):
                opened = interface.attach(can_spec(system.deployment, name), number=number)
                self._stack.callback(opened.close)
                self.attached[name] = opened
        except BaseException:
            self._stack.close()
            raise

    def _expect(self, bus: str) -> None:
        known = self._by_bus[bus]
        for node, spec in self.system.deployment.nodes.items():
            beats = self.system.services[bus].heartbeats
            if spec.number in beats:
                message = beats[spec.number].message
                self.beats.setdefault(node, Beat(message))
                known[message.id] = self.beats[node]
        for carried in self.system.messages.values():
            if carried.bus != bus:
                continue
            message = carried.encoding.message
            receiver = native.receiver(carried.period_ns, Profile(message.e2e))
            values = np.full(carried.outlet.width, np.nan)
            found = Heard(carried.name, carried.node, message, receiver, values)
            self.heard[carried.name] = known[message.id] = found

    def take(self, now_ns: int) -> int:
        """Everything that has come; how many frames. Call it some ten times a second."""
        total = 0
        for name, attachment in self.attached.items():
            for frame in attachment.bus.drain():
                total += 1
                match self._by_bus[name].get(int(frame.id)):
                    case Beat() as beat:
                        _beaten(beat, frame)
                    case Heard() as heard:
                        heard.take(frame)
                    case None:
                        self.unknown[name] += 1
        for heard in self.heard.values():
            while heard.times and heard.times[0] <= now_ns - SPAN_NS:
                heard.times.popleft()
        return total

    def close(self) -> None:
        """Let go of the buses."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _beaten(beat: Beat, frame: Frame) -> None:
    values, header = np.zeros(4), Header()
    if native.decode(beat.message, frame, values.ctypes.data, header) is not Decoded.OK:
        return
    state, reasons, boots, armed = (int(v) for v in values)
    beat.t_ns, beat.boots, beat.armed = int(frame.t_ns), boots, bool(armed)
    beat.state = _state(state)
    beat.reasons = explain(reasons) if reasons else ""


def _state(number: int) -> str:
    known: Mapping[int, State] = {int(s): s for s in State}
    return known[number].name.lower() if number in known else f"{number}?"


# ---- in words -------------------------------------------------------------------------------


def view(listener: Listener, now_ns: int) -> View:
    """What is known at `now_ns` (monotonic), to be shown."""
    beats = listener.beats.items()
    there = [f"{n} {b.state}" for n, b in beats if b.t_ns >= 0 and now_ns - b.t_ns <= SPAN_NS]
    rates = [f"{h.name} {len(h.times)}/s" for h in listener.heard.values()]
    buses = ", ".join(listener.attached)
    line = f"{', '.join(there) or 'no heartbeat'}; {', '.join(rates)}"
    return View(f"listening on {buses}", line, tables(listener, now_ns))


def tables(listener: Listener, now_ns: int) -> list[Table]:
    """What is known, as tables."""
    beats, heard = listener.beats, [*listener.heard.values()]
    silent = frozenset(
        i for i, b in enumerate(beats.values()) if now_ns - b.t_ns > SPAN_NS or b.state != "active"
    )
    quiet = frozenset(i for i, h in enumerate(heard) if not h.times or h.lost or h.refused)
    return [
        Table(
            "nodes, by their heartbeats",
            ("node", "state", "ago ms", "boots", "armed", "reasons"),
            [_beat_row(name, b, now_ns) for name, b in beats.items()],
            silent,
        ),
        Table(
            "messages",
            ("message", "from", "1/s", "ago ms", "lost", "refused", "sender", "values"),
            [_heard_row(h, now_ns) for h in heard],
            quiet,
        ),
        Table("buses", ("bus", "frames/s", "load"), [_bus_row(listener, n, now_ns)
              for n in listener.attached]),
    ]  # fmt: skip


def _ago(t_ns: int, now_ns: int) -> str:
    return "never" if t_ns < 0 else f"{max(0, now_ns - t_ns) * 1e-6:.0f}"


def _beat_row(name: str, b: Beat, now_ns: int) -> tuple[str, ...]:
    armed = ("yes" if b.armed else "no") if b.t_ns >= 0 else ""
    return (name, b.state or "?", _ago(b.t_ns, now_ns), str(b.boots), armed, b.reasons)


def _heard_row(h: Heard, now_ns: int) -> tuple[str, ...]:
    values = "  ".join(f"{v:9.4g}" for v in h.values[:8])
    lost = str(h.lost) if h.message.e2e else ""
    ago = _ago(h.t_ns, now_ns)
    return (h.name, h.node, str(len(h.times)), ago, lost, str(h.refused), _sender(h), values)


def _sender(h: Heard) -> str:
    """State and flags of who sent it; a status of 4 bits (classic CAN) has no state."""
    if h.message.status < 0 or h.t_ns < 0:
        return ""
    whole = h.message.header[h.message.status].scale == 1.0
    flags = names(Status(h.status & ~_LIFE & 0xFF))
    return " ".join((*([_state(h.status & _LIFE)] if whole else []), *flags))


def _bus_row(listener: Listener, name: str, now_ns: int) -> tuple[str, ...]:
    spec = listener.system.deployment.buses[name]
    rate = listener.attached[name].bus.traffic.last_second(now_ns)
    load = rate.load(spec.bitrate, spec.data_bitrate if spec.fd else None)
    return (name, str(rate.frames), f"{load:.1%}")
