"""A CAN bus without a node: frames sent and received one by one, with their times of arrival."""

from __future__ import annotations

from typing import NamedTuple, final

import can

from bridge.can.interface import CanBusSpec, configuration, open_device
from bridge.can.socket import BusError
from bridge.can.threaded import to_frame, to_message
from bridge.native.frame import Frame
from cosim.base.clock import monotonic_ns, now_and_date


class ArrivedFrame(NamedTuple):
    """A frame that arrived at `t_ns` (monotonic), `wake_ns` before it could be processed."""

    frame: Frame
    t_ns: int
    wake_ns: int


@final
class PlainBus:
    """A bus of python-can. Raises BusError if it cannot be opened."""

    def __init__(self, spec: CanBusSpec) -> None:
        config = configuration(spec)
        self._dated = config["interface"] == "socketcan"  # its stamps are dates of the kernel
        self._device = open_device(spec, config)
        self._name = spec.name

    def send(self, frame: Frame) -> None:
        """Send a frame. Raises BusError if the driver refuses it."""
        try:
            self._device.send(to_message(frame), timeout=0.1)
        except (can.CanError, OSError, ValueError) as error:
            raise BusError(f"bus {self._name}: {error}") from None

    def receive(self, until_ns: int) -> ArrivedFrame | None:
        """The next frame, None if there is none before `until_ns` (monotonic)."""
        left = max(0.0, (until_ns - monotonic_ns()) * 1e-9)
        try:
            message = self._device.recv(timeout=left)
        except (can.CanError, OSError, ValueError) as error:
            raise BusError(f"bus {self._name}: {error}") from None
        if message is None:
            return None
        waited = 0
        now, date = now_and_date()
        if self._dated:
            waited = date - round(message.timestamp * 1e9)
        waited = waited if 0 <= waited < 1_000_000_000 else 0
        return ArrivedFrame(to_frame(message, now - waited), now - waited, waited)

    def close(self) -> None:
        """Close the bus."""
        self._device.shutdown()
