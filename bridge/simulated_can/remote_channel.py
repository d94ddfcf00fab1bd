"""The client of a simulated bus that another process serves (`bridge.bus_server.server`)."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, final

import can
from can.broadcastmanager import (
    LimitedDurationCyclicSendTaskABC,
    ModifiableCyclicTaskABC,
    RestartableCyclicTaskABC,
)
from can.typechecking import CanFilters

from bridge.simulated_can.channel import Wanted
from bridge.simulated_can.options import (
    ChannelOperationError,
    ChannelOptionError,
    ChannelOptions,
    ChannelTimeoutError,
    PortOptions,
)
from bridge.simulated_can.protocol import (
    CallSocket,
    connect,
    is_plain,
    pack_message,
    parse_address,
    unpack_frame,
    unpack_message,
)
from bridge.simulated_can.thread_connection import (
    BusConnection,
    connection_to,
    end_connections,
    settle,
)
from cosim.base.copies import asdict
from cosim.bus.frames import ControllerState
from cosim.bus.settings import Disturbance
from cosim.bus.timing import BusTiming

_ERRORS = {e.__name__: e for e in (ChannelOptionError, ChannelOperationError, ChannelTimeoutError)}
_BATCH = 64
"""Messages that one call fetches."""


@final
class RemoteChannel:
    """A simulated bus of another process, for one bus object here.

    Each thread has a connection of its own to the server, so that one can send while another waits.
    A message for which the transmit queue has room is posted: sending it does not wait for the
    server. The server takes it before all later calls of this process, whatever their thread and
    bus.

    Raises ChannelOptionError if no server answers at its address or the server has other options.
    """

    def __init__(self, channel: str, options: ChannelOptions, port: PortOptions) -> None:
        self._address = parse_address(channel)
        self.name = channel
        calls = CallSocket(connect(self._address))
        said = {k: v for k, v in asdict(options).items() if k != "timing" and v is not None}
        if options.timing is not None:
            said["bitrate"] = options.timing.bitrate
        with suppress(OSError):  # then there is no answer
            calls.send(["open", self._address.channel, said, asdict(port)])
        opened = self._value(calls.receive())
        self._opened = BusConnection(calls)
        self._server, self._token, bitrate, data_bitrate, fd = opened
        self.timing = BusTiming(bitrate, data_bitrate, fd=fd)
        self._inbox: deque[can.Message] = deque()
        self._sending = threading.Lock()
        self._sent, self._most = 0, 0
        """Messages sent so far, and how many can be before one has to wait for an answer."""

    def call(self, method: str, *arguments: object) -> Any:
        """The answer to a call, on the connection of this thread."""
        connection = connection_to(self._address, self._server, self._token)
        return self._value(connection.ask(method, self._token, self._sent, *arguments))

    def _value(self, answer: Any) -> Any:
        """The value of an answer. Raises ChannelOperationError and other errors of the server."""
        if answer is None:
            raise ChannelOperationError(
                f"channel {self.name!r}: found the connection to {self._address.place} closed"
            )
        if answer[0] == "error":
            raise _ERRORS.get(answer[1], ChannelOperationError)(answer[2])
        if len(answer) > 2:
            self._most = answer[2]
        return answer[1]

    def time(self) -> float:
        """Time of the channel in s, plus the date of its opening in wall time."""
        return float(self.call("time"))

    def status(self) -> tuple[ControllerState, int, int]:
        """State, TEC and REC now."""
        state, tec, rec = self.call("status")
        return ControllerState(state), tec, rec

    def lost(self) -> int:
        """Frames that were received while the receive queue was full."""
        return int(self.call("lost"))

    def load(self, window: float) -> float:
        """The share of the last `window` (s) in which the bus was busy, 0 to 1."""
        return float(self.call("load", window))

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds (s) of the channel."""
        self.call("sleep", seconds)

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance from the end of the transmission under way on."""
        self.call("disturb", type(disturbance).__name__, asdict(disturbance))

    def flush(self) -> None:
        """Drop what waits in the transmit queue."""
        self.call("flush")

    def reset(self) -> None:
        """Restart the controller, as after bus-off."""
        self.call("reset")

    def filter(self, filters: CanFilters | None) -> None:
        """Receive only what passes one of these filters; None: everything."""
        said = [[f["can_id"], f["can_mask"], f.get("extended")] for f in filters or ()]
        self.call("filter", said)

    def send(self, message: can.Message, timeout: float | None) -> None:
        """Queue a message, waiting up to `timeout` (s) for room."""
        packed = pack_message(message)
        if not is_plain(packed):
            unpack_frame(packed, self._address.channel, self.timing)  # raises as the server does
        connection = connection_to(self._address, self._server, self._token)
        with self._sending:
            before, self._sent = self._sent, self._sent + 1
        if before >= self._most or not connection.known:
            self._value(connection.ask("send", self._token, before, packed, timeout))
            return
        try:
            connection.post(self._token, before, packed, self._opened)
        except OSError:
            self._value(None)

    def receive(self, wanted: Wanted | None, timeout: float | None) -> can.Message | None:
        """The oldest message, waiting up to `timeout` (s; None: for ever)."""
        if self._inbox:
            with suppress(IndexError):  # another thread was first
                return self._inbox.popleft()
        found = self.call("receive", timeout, _BATCH)
        if not found:
            return None
        if len(found) > 1:
            self._inbox.extend(unpack_message(m, self.name) for m in found[1:])
        return unpack_message(found[0], self.name)

    def periodic(
        self,
        sender: object,
        messages: can.Message | Sequence[can.Message],
        period: float,
        duration: float | None,
        modifier: Callable[[can.Message], None] | None,
    ) -> RemotePeriodicTask | None:
        """Messages that the other process sends every `period` (s) of the channel.

        `duration`: s, None: no end. Returns None with a `modifier`, which has to be called here.
        """
        return None if modifier else RemotePeriodicTask(self, messages, period, duration)

    def leave(self) -> None:
        """Leave the bus; what was queued is still sent."""
        settle(self._server, self._token)
        self._opened.leave(self._sent)
        end_connections(self._server, self._token)


@final
class RemotePeriodicTask(
    LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC
):
    """Messages in turn, every `period` seconds of the channel, sent by the process that has it."""

    def __init__(
        self,
        channel: RemoteChannel,
        messages: can.Message | Sequence[can.Message],
        period: float,
        duration: float | None,
    ) -> None:
        super().__init__(messages, period, duration)
        self._channel = channel
        packed = [pack_message(m) for m in self.messages]
        self._number = channel.call("periodic", packed, period, duration)

    @property
    def stopped(self) -> bool:
        """True if it sends nothing more, as python-can's own tasks have it."""
        return bool(self._channel.call("stopped", self._number))

    def start(self) -> None:
        """Send the first message now; does nothing to a task that runs."""
        self._channel.call("start", self._number)

    def stop(self) -> None:
        """Send no more."""
        self._channel.call("stop", self._number)

    def modify_data(self, messages: Sequence[can.Message] | can.Message) -> None:
        """Send these data from now on; the identifiers stay."""
        super().modify_data(messages)
        self._channel.call("modify", self._number, [pack_message(m) for m in self.messages])
