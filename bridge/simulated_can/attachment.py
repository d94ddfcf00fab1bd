"""A node's end of a simulated bus in simulated time: frames have the times of the bus, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

import can

from bridge.can.health import BusHealth, bus_health
from bridge.can.interface import CanBusSpec
from bridge.can.socket import BusError
from bridge.can.threaded import to_frame, to_message
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Frame, Ring
from bridge.native.journal import Journal
from bridge.simulated_can.bus import CosimBus
from bridge.simulated_can.options import SIMULATED
from bridge.simulated_can.protocol import is_remote
from cosim.base.copies import replace

#: Frames that may wait at a node between two of its slots.
RING = 1024


@final
class SimulatedAttachment:
    """A bus that another process serves in simulated time, for a node on the simulated clock.

    What arrives is put into the rings of `bus` when the node asks for it (`hear`), and what the
    node has put there is requested on the bus now (`send`). All methods are for one thread.
    Raises BusError where there is no such bus.
    """

    def __init__(self, spec: CanBusSpec, number: int, log: Journal | None) -> None:
        if not is_remote(spec.channel):
            raise BusError(
                f"bus {spec.name}: found the channel {spec.channel!r}, expected NAME@ADDRESS of a "
                "simulated bus that a rehearsal serves"
            )
        try:
            self._device = CosimBus(spec.channel, **_options(spec), receive_own_messages=True)
        except can.CanError as error:
            raise BusError(f"bus {spec.name}: {error}") from error
        self._name, self._frame = spec.name, Frame()
        self._refused, self._fault = 0, ""
        self._rx, self._tx = Ring(RING), Ring(RING)
        self.bus = Bus.from_rings(self._rx, self._tx, number, kind=BusKind.MEMORY)
        self._log_rx, self._log_tx = Ring(1), Ring(1)
        self._log = Bus.from_rings(
            self._log_rx, self._log_tx, number, log, kind=BusKind.MEMORY
        )  # for the log alone
        self._now_ns = round(self._device.time * 1e9)  # the first call: time waits for this thread

    def wait_until(self, t_ns: int) -> None:
        """Let the time of all buses pass until `t_ns` (ns since their start)."""
        if t_ns > self._now_ns:
            self._device.sleep((t_ns - self._now_ns) / 1e9)
            self._now_ns = t_ns

    def hear(self) -> None:
        """Take in what has arrived; log it, and what was sent, at the times of the bus."""
        while (message := self._device.recv(0)) is not None:
            at_ps = round(message.timestamp * 1e12)  # exact in the first two hours
            frame = to_frame(message, (at_ps + 500) // 1000)
            if message.is_rx:
                self._rx.put(frame)
                self._log_rx.put(frame)
                self._log.receive(frame)
            else:
                self._log.send(frame)
                self._log_tx.get(frame)

    def send(self) -> None:
        """Request the frames that the node has sent."""
        while self._tx.get(self._frame):
            try:
                self._device.send(to_message(self._frame))
            except can.CanError as error:
                self._refused += 1
                self._fault = str(error)

    def health(self, now_ns: int) -> BusHealth:
        """State and counts at `now_ns` (monotonic), with what the transmit queue refused."""
        found = bus_health(self.bus, self._name, now_ns)
        return replace(
            found,
            send_failed=found.send_failed + self._refused,
            last_error=self._fault or found.last_error,
            log_dropped=bus_health(self._log, self._name, now_ns).log_dropped,
        )

    def close(self) -> None:
        """Leave the bus."""
        self._device.shutdown()


def _options(spec: CanBusSpec) -> Mapping[str, Any]:
    return {
        "bitrate": spec.bitrate, "data_bitrate": spec.data_bitrate, "fd": spec.fd,
        **spec.options, "speed": SIMULATED,
    }  # fmt: skip
