"""A passive listener: state of a deployment's nodes from the traffic of its buses.

It sends nothing (a CAN controller still acknowledges frames, unless its interface is set to listen
only). Heartbeats give the state of a node, messages give values, counters of messages give losses,
and on Zenoh tokens give the nodes that are present.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Protocol, Self, final

from bridge.can import interface
from bridge.can.interface import Attachment
from bridge.deployment.spec import BusSpec, Deployment
from bridge.deployment.system import System
from bridge.monitor.messages import Beat, ReceivedMessage
from bridge.native.bus import Accept, TrafficStruct
from bridge.native.frame import Frame
from bridge.node.buses import can_spec
from cosim.base.errors import ScenarioError

if TYPE_CHECKING:
    from bridge.zenoh.listener import ZenohEar

#: The certificate's name of who listens, where there are any.
WHO = "monitor"


class Ear(Protocol):
    """A bus that is listened to; `traffic`: what was on it."""

    @property
    def traffic(self) -> TrafficStruct:
        """Frames and bits."""

    def drain(self) -> Sequence[Frame]:
        """All frames that have come since the last time."""

    def close(self) -> None:
        """Let go of the bus."""


@final
class CanEar:
    """A CAN bus. Raises BusError where it cannot be opened."""

    def __init__(self, system: System, bus: str, number: int) -> None:
        spec = can_spec(system.deployment, bus)
        self._attached: Attachment = interface.attach(spec, number=number)
        self.traffic = self._attached.bus.traffic

    def drain(self) -> Sequence[Frame]:
        """All frames that have come since the last time."""
        return self._attached.bus.drain()

    def close(self) -> None:
        """Let go of the bus."""
        self._attached.close()


@final
class Listener:
    """Buses of a system, open for listening: `only` these, or all.

    `connect`: endpoints of Zenoh other than the deployment's; `who`: name of the certificate.
    Raises ScenarioError, or BusError if a bus cannot be opened.
    """

    def __init__(
        self,
        system: System,
        connect: Sequence[str] = (),
        who: str = WHO,
        only: Sequence[str] = (),
    ) -> None:
        self.system = system
        self.beats: dict[str, Beat] = {}
        self.heard: dict[str, ReceivedMessage] = {}
        self.ears: dict[str, Ear] = {}
        self.nets: dict[str, ZenohEar] = {}
        self.new_ns = 0
        """When a message was last listened to that was not before, monotonic; 0: from the start."""
        buses = _selected_buses(system.deployment, only)
        self._by_bus: dict[str, dict[int, list[tuple[Accept, Beat | ReceivedMessage]]]]
        self._by_bus = {name: {} for name in buses}  # by identifier, which two formats may share
        self.unknown: dict[str, int] = dict.fromkeys(buses, 0)
        for name in buses:
            self._expect(name)
        self._stack = ExitStack()
        try:
            for number, (name, bus) in enumerate(buses.items()):
                if bus.kind == "zenoh":
                    self.ears[name] = self.nets[name] = _zenoh(system, name, connect, who)
                else:
                    self.ears[name] = CanEar(system, name, number)
                self._stack.callback(self.ears[name].close)
        except BaseException:
            self._stack.close()
            raise

    def _expect(self, bus: str) -> None:
        known: list[Beat | ReceivedMessage] = []
        for node, spec in self.system.deployment.nodes.items():
            beats = self.system.services[bus].heartbeats
            if spec.number in beats:
                message = beats[spec.number].message
                self.beats.setdefault(node, Beat(message))
                known.append(self.beats[node])
        for carried in self.system.messages.values():
            if carried.bus == bus:
                self.heard[carried.name] = ReceivedMessage.of(carried)
                known.append(self.heard[carried.name])
        for one in known:
            same = self._by_bus[bus].setdefault(int(one.message.id), [])
            same.append((Accept.of(one.message), one))

    def receive(self, now_ns: int) -> int:
        """Read all frames that have arrived; return their number. Call it ten times per second."""
        total = 0
        for name, ear in self.ears.items():
            for frame in ear.drain():
                total += 1
                self._receive_frame(name, frame)
        for heard in self.heard.values():
            heard.forget(now_ns)
        for net in self.nets.values():
            if net.follow():
                self.new_ns = now_ns
        return total

    def _receive_frame(self, bus: str, frame: Frame) -> None:
        same = self._by_bus[bus].get(int(frame.id), ())
        match next((one for accept, one in same if accept.takes(frame)), None):
            case Beat() as beat:
                if beat.decode(frame):
                    self._begin_new_life(beat)
            case ReceivedMessage() as heard:
                heard.decode(frame)
            case None:
                self.unknown[bus] += 1

    def _begin_new_life(self, beat: Beat) -> None:
        """A node has begun a new life, and its messages with it."""
        node = next(n for n, b in self.beats.items() if b is beat)
        for heard in self.heard.values():
            forward = heard.carried.forward
            first = self.system.messages[forward.origin] if forward else heard.carried
            if first.node == node:
                heard.renew()

    def there(self, node: str) -> bool | None:
        """True if a node's token is there; None: it is on no Zenoh bus."""
        known = [net.nodes[node] for net in self.nets.values() if node in net.nodes]
        return any(known) if known else None

    def close(self) -> None:
        """Let go of the buses."""
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _selected_buses(d: Deployment, only: Sequence[str]) -> dict[str, BusSpec]:
    for name in only:
        if name not in d.buses:
            raise ScenarioError(f"no bus {name!r}; there are: {', '.join(d.buses)}", str(d.path))
    found = {name: bus for name, bus in d.buses.items() if not only or name in only}
    if not found:
        raise ScenarioError("no bus to listen to", str(d.path))
    return found


def _zenoh(system: System, bus: str, connect: Sequence[str], who: str) -> ZenohEar:
    from bridge.zenoh.listener import open_listener

    return open_listener(system, bus, connect, who)
