"""python-can's interface ``cosim``: a bus with arbitration, exact frame times and errors.

    can.Bus(interface="cosim", channel="bench", bitrate=500_000)

All bus objects of one channel name in one process are nodes of one simulated bus; ``NAME@ADDRESS``
is a bus that another process serves with `cosim bus`. docs/can.md says what the options mean and
how time passes.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple, final

import can
from can.bus import CanProtocol
from can.typechecking import AutoDetectedConfig, CanFilters

from bridge.simulated_can.local_channel import channel_names, place_on
from bridge.simulated_can.options import (
    ChannelOperationError,
    PortOptions,
    channel_options,
    queue_kind,
    refuse_misspelt,
)
from cosim.bus.frames import ControllerState
from cosim.bus.settings import Disturbance

_STATES = {ControllerState.PASSIVE: can.BusState.PASSIVE, ControllerState.OFF: can.BusState.ERROR}


class ErrorCounters(NamedTuple):
    """Transmit and receive error counter of a controller."""

    tec: int
    rec: int


@final
class CosimBus(can.BusABC):
    """A node on a simulated bus.

    The bus that opens a channel gives `bitrate` (bit/s) or `timing`, for CAN FD `fd` and
    `data_bitrate` (default: `bitrate`), and `speed`: how fast time passes, as a multiple of the
    wall clock (default 1.0), or "simulated": it passes when all threads that use the channel wait.
    `error_rate`: probability that a bit is inverted, with random numbers from `seed`. Further buses
    may leave these out; what they give has to agree.

    Each bus has its own: `queue` ("fifo", "sorted", "mailboxes") and `tx_queue_size` (frames) for
    transmission, `rx_queue_size` (frames; 0: no limit; then new ones are lost), `one_shot`,
    `auto_restart` after bus-off, `bus_errors` (an error frame for each error and lost arbitration,
    not for changes of state only), `receive_own_messages`.

    Raises ChannelOptionError (a can.CanInitializationError) for options that cannot be.
    """

    def __init__(
        self,
        channel: Hashable = "cosim",
        can_filters: CanFilters | None = None,
        *,
        bitrate: float | str | None = None,
        data_bitrate: float | str | None = None,
        fd: bool | None = None,
        timing: can.BitTiming | can.BitTimingFd | None = None,
        speed: float | str | None = None,
        error_rate: float | None = None,
        seed: int | None = None,
        receive_own_messages: bool = False,
        queue: str = "fifo",
        tx_queue_size: int = 1000,
        rx_queue_size: int = 0,
        one_shot: bool = False,
        auto_restart: bool = True,
        bus_errors: bool = False,
        **kwargs: object,
    ) -> None:
        refuse_misspelt(channel, kwargs, type(self).__init__.__kwdefaults__ or ())
        options = channel_options(
            channel,
            bitrate=bitrate,
            data_bitrate=data_bitrate,
            fd=fd,
            timing=timing,
            speed=speed,
            error_rate=error_rate,
            seed=seed,
        )
        port = PortOptions(
            queue=queue_kind(channel, queue),
            tx_queue_size=int(tx_queue_size),
            rx_queue_size=int(rx_queue_size),
            receive_own_messages=receive_own_messages,
            bus_errors=bus_errors,
            auto_restart=auto_restart,
            one_shot=one_shot,
        )
        self._place = place_on(channel, options, port)
        rates = self._place.timing
        self._can_protocol = CanProtocol.CAN_FD if rates.fd else CanProtocol.CAN_20
        data_phase = f", data {rates.data_bitrate:g} bit/s" if rates.data_bitrate else ""
        self.channel_info = f"cosim channel {channel!r}: {rates.bitrate:g} bit/s{data_phase}"
        super().__init__(channel=channel, can_filters=can_filters)  # type: ignore[arg-type]

    @property
    def time(self) -> float:
        """Seconds of the channel since it was opened, plus, in wall time, the date of that."""
        self._check_open()
        return self._place.time()

    @property
    def state(self) -> can.BusState:
        """ACTIVE, PASSIVE (error passive) or ERROR (bus-off), by the error counters."""
        self._check_open()
        return _STATES.get(self._place.status()[0], can.BusState.ACTIVE)

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        """ACTIVE restarts the controller, after bus-off for example; there is no other to set."""
        if new_state != can.BusState.ACTIVE:
            raise NotImplementedError(f"{self.channel_info}: found {new_state}, expected ACTIVE")
        self.reset()

    @property
    def error_counters(self) -> ErrorCounters:
        """TEC and REC now."""
        self._check_open()
        return ErrorCounters(*self._place.status()[1:])

    @property
    def lost(self) -> int:
        """Frames that were received while the receive queue was full."""
        return self._place.lost()

    def load(self, window: float = 1.0) -> float:
        """The share of the last `window` (s) in which the bus was busy, 0 to 1.

        From each start of frame to the end of the intermission, failed attempts included.
        """
        self._check_open()
        return self._place.load(window)

    def sleep(self, seconds: float) -> None:
        """Let so many seconds (s) of the channel pass."""
        self._check_open()
        self._place.sleep(seconds)

    def disturb(self, disturbance: Disturbance) -> None:
        """Disturb bits of this bus; nodes are numbered as its buses were opened, from 0.

        It is in force from the end of the transmission under way on. Attempts are counted, and
        interruptions timed, from now.
        """
        self._check_open()
        self._place.disturb(disturbance)

    def reset(self) -> None:
        """Restart the controller, after bus-off for example; what waits is dropped."""
        self._check_open()
        self._place.reset()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message; `timeout` (s): how long to wait for room, None: not at all.

        Raises ChannelOperationError (a can.CanOperationError): queue full, bus-off, closed, or a
        message that this bus cannot carry.
        """
        if self._is_shutdown:
            self._check_open()
        self._place.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """The next message that passes the filters; None after `timeout` (s) of the channel.

        python-can's own method measures time-outs by the wall clock.
        """
        if self._is_shutdown:
            self._check_open()
        return self._place.receive(self._wanted if self._filters else None, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return self.recv(timeout), True

    def _apply_filters(self, filters: CanFilters | None) -> None:
        self._place.filter(filters)

    def _wanted(self, message: can.Message) -> bool:
        return message.is_error_frame or self._matches_filters(message)

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> Any:
        self._check_open()
        task = self._place.periodic(self, msgs, period, duration, modifier_callback)
        if task is None:
            return super()._send_periodic_internal(
                msgs, period, duration, autostart, modifier_callback
            )
        if autostart:
            task.start()
        return task

    def flush_tx_buffer(self) -> None:
        """Drop the messages that wait; one that is being sent is finished."""
        self._check_open()
        self._place.flush()

    def shutdown(self) -> None:
        """Leave the bus; what was queued is still sent. May be called again."""
        if not self._is_shutdown:
            super().shutdown()
            self._place.leave()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        """The channels that are open in this process; a bus joins them without further options."""
        found: list[Any] = [{"interface": "cosim", "channel": name} for name in channel_names()]
        return found

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise ChannelOperationError(f"{self.channel_info}: found a bus that is shut down")
