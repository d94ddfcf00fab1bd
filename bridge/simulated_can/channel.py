"""A simulated CAN bus by its name: the bus objects of this process that are on it."""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias, final

import can

from bridge.simulated_can.busy_time import HISTORY_S
from bridge.simulated_can.error_frames import error_message
from bridge.simulated_can.frames import MESSAGES, MessageForm, frame_of_message
from bridge.simulated_can.node import Happening, WireNode, WireRecorder
from bridge.simulated_can.options import (
    ChannelOperationError,
    ChannelOptionError,
    ChannelOptions,
    ChannelTimeoutError,
    PortOptions,
)
from bridge.simulated_can.pace import BusPace, ChannelLock, Paced, SimulatedPace, WallPace, earlier
from bridge.simulated_can.shared_time import SharedTime
from bridge.simulated_can.wire import CanWire
from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings, Disturbance, ErrorRate

Wanted: TypeAlias = Callable[[Any], bool]
_SENT, _RECEIVED = int(BusEvent.SENT), int(BusEvent.RECEIVED)
_CHANGES = (BusEvent.STATE, BusEvent.RECOVERED)


class Scheduled(Protocol):
    """Something that is due at times of the channel."""

    def fire(self, due_ps: int) -> int | None:
        """Do it; returns when it is due next, ps, or None."""


@dataclass(eq=False)
class ChannelPort:
    """One bus object: its node on the wire, and what it received."""

    node: WireNode
    options: PortOptions
    form: MessageForm = MESSAGES
    inbox: deque[Any] = field(default_factory=deque)
    """Messages, in that form."""
    lost: int = 0
    """Frames that were received while the queue was full."""


@final
class Channel:
    """A bus with all its ports. Every method takes the lock itself; times are ps of the channel.

    `time`: that of other channels, too; the channel's `speed` is then that of simulated time.
    """

    def __init__(
        self, name: Hashable, options: ChannelOptions, time: SharedTime | None = None
    ) -> None:
        if options.timing is None:
            raise ChannelOptionError(
                f"channel {name!r}: found no bitrate, expected one from the bus that opens the "
                "channel, such as bitrate=500000"
            )
        speed = 0.0 if time else 1.0 if options.speed is None else options.speed
        self.name = name
        self.options = ChannelOptions(
            timing=options.timing,
            fd=options.timing.fd,
            data_bitrate=options.timing.data_bitrate or options.timing.bitrate,
            speed=speed,
            error_rate=options.error_rate or 0.0,
            seed=options.seed or 0,
        )
        self.timing = options.timing
        self.lock = time.lock if time else ChannelLock()
        self.ports: list[ChannelPort] = []
        self._paced: Paced = time or self
        self.pace: BusPace = WallPace(speed) if speed else SimulatedPace()
        errors = [ErrorRate(options.error_rate)] if options.error_rate else []
        self._wire = CanWire(self.timing, errors, self.options.seed or 0)
        self._by_node: dict[WireNode, ChannelPort] = {}
        self._due: list[tuple[int, int, Scheduled]] = []
        self._numbers = itertools.count()
        self._firing = False
        if time is not None:
            self.pace = time.pace
            time.join(self)

    @property
    def now_ps(self) -> int:
        """The time that the channel has reached, ps."""
        return self._wire.now_ps

    def open(self, options: PortOptions, form: MessageForm = MESSAGES) -> ChannelPort:
        """A new port, which receives messages in this form."""
        with self.lock:
            self._catch_up()
            settings = BusNodeSettings(
                f"{self.name} {len(self.ports)}",
                options.queue,
                queue_length=options.tx_queue_size,
                one_shot=options.one_shot,
                recovers=options.auto_restart,
                inbox=options.tx_queue_size,
            )
            port = ChannelPort(WireNode(settings), options, form)
            self._by_node[port.node] = port
            self.ports.append(port)
            self._wire.join(port.node)
            return port

    def record(self, recorder: WireRecorder | None) -> None:
        """Tell `recorder` of all nodes, and of their requests and all events from now on.

        None ends the record: the one before is told nothing more and can be read.
        """
        with self.lock:
            self._wire.record(recorder)

    def add_node(self, name: str) -> WireNode:
        """A node that only sends (`offer`), the most urgent first; it stays with the channel."""
        with self.lock:
            node = WireNode(BusNodeSettings(name, queue_length=1000, inbox=8192))
            self._wire.join(node)
            return node

    def offer(self, frames: Iterable[tuple[int, WireNode, BusFrame]]) -> None:
        """Frames that nodes of `add_node` send, by time: (when, ps, node, frame)."""
        with self.lock:
            self._wire.offer(frames)

    def close(self, port: ChannelPort) -> None:
        """Let a port go; what it has queued is still sent while others are there."""
        with self.lock:
            self._catch_up()
            self.ports.remove(port)
            del self._by_node[port.node]
            port.inbox.clear()
            self._wire.leave(port.node)
            self.lock.notify_all()

    def send(self, port: ChannelPort, message: can.Message, timeout: float | None) -> None:
        """Queue a message; `timeout` (s): how long to wait for room, None: not at all.

        Raises ChannelOperationError: no room, bus-off, or no frame of this channel.
        """
        self.send_frame(port, frame_of_message(message, self.name, self.timing), timeout)

    def send_frame(self, port: ChannelPort, frame: BusFrame, timeout: float | None) -> None:
        """Queue a frame that this channel can carry; `timeout` (s) as for :meth:`send`.

        Raises ChannelOperationError: no room, or bus-off.
        """
        with self.lock.held:
            if not self._firing:
                self.pace.catch_up(self._paced)
            if port.node.state == ControllerState.OFF:
                raise ChannelOperationError(f"channel {self.name!r}: found the node bus-off")
            if not self._room(port) and not (
                timeout and self.pace.wait(self._paced, lambda: self._room(port), timeout, None)
            ):
                error = ChannelTimeoutError if timeout else ChannelOperationError
                raise error(
                    f"channel {self.name!r}: found {port.options.tx_queue_size} frames in the "
                    "transmit queue, expected room; send(timeout=...) waits for it"
                )
            self._wire.send(port.node, frame)
            self.lock.notify_all()

    def receive(
        self, port: ChannelPort, wanted: Wanted | None, timeout: float | None
    ) -> can.Message | None:
        """The oldest message that is `wanted`, waiting up to `timeout` (s; None: for ever).

        `wanted` None: every message. Raises ChannelOperationError when the port is closed
        meanwhile.
        """
        found = self.receive_several(port, wanted, timeout, 1)
        return found[0] if found else None

    def receive_several(
        self, port: ChannelPort, wanted: Wanted | None, timeout: float | None, most: int
    ) -> list[Any]:
        """The oldest messages that are `wanted`, up to `most` of them, in the form of the port.

        It waits for the first, up to `timeout` (s; None: for ever). Raises
        ChannelOperationError when the port is closed meanwhile.
        """
        inbox, node = port.inbox, port.node

        def ready() -> bool:
            while inbox and wanted and not wanted(inbox[0]):
                inbox.popleft()
            return bool(inbox) or node.leaving

        with self.lock.held:
            found = self.pace.wait(self._paced, ready, timeout, None)
            if port.node.leaving:
                raise ChannelOperationError(
                    f"channel {self.name!r}: found a bus that was shut down while it waited"
                )
            messages = [inbox.popleft()] if found else []
            while inbox and len(messages) < most and ready():
                messages.append(inbox.popleft())
            return messages

    def has_room(self, port: ChannelPort) -> bool:
        """True if the transmit queue of a port has room for a frame."""
        with self.lock:
            return self._room(port)

    def room(self, port: ChannelPort) -> int:
        """The number of frames that the transmit queue of a port has room for; 0: bus-off."""
        if port.node.state == ControllerState.OFF:
            return 0
        return port.options.tx_queue_size - self._wire.waiting(port.node)

    def received(self, port: ChannelPort, wanted: Wanted | None) -> can.Message | None:
        """The oldest message that is `wanted` of those that are there; time does not move."""
        with self.lock:
            while port.inbox and wanted and not wanted(port.inbox[0]):
                port.inbox.popleft()
            return port.inbox.popleft() if port.inbox else None

    def time(self, port: ChannelPort) -> float:
        """Time of the channel in s, plus the date of its opening in wall time."""
        self.state(port)
        return self.pace.epoch + self.now_ps / 1e12

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds (s) of the channel."""
        with self.lock:
            self._catch_up()
            self.pace.wait(self._paced, lambda: False, None, self.now_ps + round(seconds * 1e12))

    def state(self, port: ChannelPort) -> tuple[ControllerState, int, int]:
        """State, TEC and REC of a port now."""
        with self.lock:
            self._catch_up()
            self._wire.count()
            return port.node.state, port.node.tec, port.node.rec

    def load(self, window: float) -> float:
        """The share of the last `window` (s) in which the bus was busy, 0 to 1.

        Raises ChannelOptionError for a window longer than the bus remembers.
        """
        if not 0 < window <= HISTORY_S:
            raise ChannelOptionError(
                f"channel {self.name!r}: found a window of {window:g} s, expected more than 0 and "
                f"at most {HISTORY_S} s"
            )
        with self.lock:
            self._catch_up()
            return self._wire.busy(round(window * 1e12))

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance from the end of the transmission under way on."""
        with self.lock:
            self._catch_up()
            self._wire.disturb(disturbance)

    def flush(self, port: ChannelPort) -> None:
        """Drop what waits in the transmit queue of a port."""
        with self.lock:
            self._catch_up()
            self._wire.abort(port.node)

    def reset(self, port: ChannelPort) -> None:
        """Restart the controller of a port, as after bus-off."""
        with self.lock:
            self._catch_up()
            self._wire.reset(port.node)
            self.lock.notify_all()

    def schedule(self, item: Scheduled) -> int:
        """Fire `item` now, and again when it says; the time that is now, ps."""
        with self.lock:
            self._catch_up()
            self._push(self.now_ps, item)
            self.lock.notify_all()
            return self.now_ps

    def next_ps(self) -> int | None:
        """The next time at which something may happen, ps; None: nothing will by itself. Needs the
        lock.
        """
        return earlier(self._wire.next_ps(), self._due[0][0] if self._due else None)

    def advance(self, until_ps: int) -> None:
        """Go on to `until_ps` (ps) and hand out what arrives. Needs the lock."""
        while self._due and self._due[0][0] <= until_ps:
            due_ps, _, item = heapq.heappop(self._due)
            self._hand_out(self._wire.advance(max(due_ps, self.now_ps)))
            later = self._fire(item, due_ps)
            if later is not None:
                self._push(later, item)
        self._hand_out(self._wire.advance(until_ps))

    def stamp(self, time_ps: int) -> float:
        """A time of the channel (ps) as its time stamps have it, s."""
        return self.pace.epoch + time_ps / 1e12

    def catch_up(self) -> None:
        """Bring the channel to where it has to be now."""
        with self.lock:
            self._catch_up()

    def _catch_up(self) -> None:
        """Bring the channel to where it has to be now; what it fires itself is sent when due."""
        if not self._firing:
            self.pace.catch_up(self._paced)

    def _fire(self, item: Scheduled, due_ps: int) -> int | None:
        """Fire an item at its time, though the channel has to be further by now."""
        self._firing = True
        try:
            return item.fire(due_ps)
        finally:
            self._firing = False

    def _push(self, due_ps: int, item: Scheduled) -> None:
        heapq.heappush(self._due, (due_ps, next(self._numbers), item))

    def _room(self, port: ChannelPort) -> bool:
        return self._wire.waiting(port.node) < port.options.tx_queue_size

    def _hand_out(self, happenings: list[Happening]) -> None:
        if not happenings:
            return
        for time_ps, node, kind, code, role, bit, frame in happenings:
            port = self._by_node.get(node)
            if port is None:
                continue
            own = kind == _SENT
            if own or kind == _RECEIVED:
                if frame and (not own or port.options.receive_own_messages):
                    stamp = self.pace.epoch + time_ps / 1e12
                    _keep(port, port.form.of_frame(frame, own, stamp, self.name))
            elif kind in _CHANGES or port.options.bus_errors:
                report = error_message(kind, code, role, bit, (node.tec, node.rec))
                if report:
                    report.timestamp = self.stamp(time_ps)
                    report.channel = self.name  # type: ignore[assignment]
                    _keep(port, port.form.of_message(report))
        self.lock.notify_all()


def _keep(port: ChannelPort, message: Any) -> None:
    size = port.options.rx_queue_size
    if size and len(port.inbox) >= size:
        port.lost += 1
    else:
        port.inbox.append(message)
