"""Simulated CAN buses of a test."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, final

from bridge.simulated_can.bus import CosimBus
from bridge.testing.case import PytestCase


@final
class CanBuses:
    """Buses that no other test sees, closed at the end of the test by `closing`."""

    def __init__(self, case: PytestCase, closing: ExitStack) -> None:
        self._case, self._closing, self._count = case, closing, 0

    def __call__(
        self, nodes: int = 2, *, bitrate: float = 500_000, **options: Any
    ) -> tuple[CosimBus, ...]:
        """The `nodes` of one new bus, as python-can's programs use them.

        `bitrate` is in bit/s, and `options` are those of :class:`CosimBus`, of every node. Time
        passes when all threads that use the bus wait (``speed="simulated"``), so that a test is as
        fast as it can be, and the same every time. Raises a can.CanInitializationError for options
        that cannot be.
        """
        self._count += 1
        channel = f"{self._case.name}#{self._count}"
        given = {"speed": "simulated", "seed": self._case.seed, **options, "bitrate": bitrate}
        return tuple(self._opened(channel, given) for _ in range(nodes))

    def _opened(self, channel: str, given: dict[str, Any]) -> CosimBus:
        bus = CosimBus(channel, **given)
        self._closing.callback(bus.shutdown)
        return bus
