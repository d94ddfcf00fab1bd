"""Ends of nodes on a Zenoh bus that send given samples, and a listener that waits for them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bridge.deployment.system import System, load_system
from bridge.monitor.listener import Listener
from bridge.native import message as native
from bridge.native.frame import Frame
from bridge.native.message import Header
from bridge.native.safety import LifeState
from bridge.zenoh.channel import ZenohAttachment
from cosim.base.clock import monotonic_ns
from tests.bridge.zenoh.rehearsed import CONFIGS
from tests.bridge.zenoh.test_channel import until

ARMS = ("master", "slave")


def loaded(*settings: str, deployment: str = "zenoh") -> System:
    return load_system(CONFIGS / "teleoperation.toml", deployment, settings)


def encoded(encoding, values, counter=0, status=0, t_us=0) -> Frame:
    frame, array = Frame(), np.array(values, dtype=np.float64)
    native.encode(encoding.message, array.ctypes.data, Header(counter, status, t_us), frame)
    return frame


def beat(system: System, node: str, state: LifeState, boots: int = 1, why: int = 0) -> Frame:
    encoding = system.services["net"].heartbeats[system.deployment.nodes[node].number]
    return encoded(encoding, [state, why, boots, 0])


def reached(listener: Listener, done: Callable[[], object], again: Callable[[], object] = bool):
    """Listen until that is so; `again` is done over and over."""

    def look() -> bool:
        again()
        listener.receive(monotonic_ns())
        return bool(done())

    until(look)


def followed(listener: Listener, end: ZenohAttachment, system: System, counter: int = 0) -> None:
    """A node says that it runs until what it says is heard."""
    carried = system.messages["xi_master"]
    heard = listener.heard["xi_master"]

    def say() -> None:
        end.bus.send(beat(system, "master", LifeState.ACTIVE))
        end.bus.send(encoded(carried.encoding, [0.0, 0.0], counter, LifeState.ACTIVE))

    reached(listener, lambda: heard.t_ns > 0, say)
