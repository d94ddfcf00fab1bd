"""Buses of python-can on a simulated channel, closed at the end of a test."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import can
import pytest

from bridge.simulated_can.bus import CosimBus

NAMES = itertools.count()


class Bench:
    """A channel of a test, in simulated time."""

    def __init__(self, stack: ExitStack) -> None:
        self.stack = stack
        self.name = f"test {next(NAMES)}"

    def bus(self, **options: Any) -> CosimBus:
        given = {"bitrate": 1_000_000, "speed": "simulated", **options}
        bus = CosimBus(self.name, **{k: v for k, v in given.items() if v is not None})
        self.stack.callback(bus.shutdown)
        return bus


@pytest.fixture
def bench() -> Iterator[Bench]:
    with ExitStack() as stack:
        yield Bench(stack)


def message(identifier: int, data: bytes = b"", **fields: Any) -> can.Message:
    given = {"is_extended_id": False, "check": True, **fields}
    return can.Message(arbitration_id=identifier, data=data, **given)


def everything(bus: can.BusABC, timeout: float = 0.1) -> list[can.Message]:
    """The frames that a bus receives until nothing comes for `timeout` seconds."""
    return list(iter(lambda: bus.recv(timeout), None))
