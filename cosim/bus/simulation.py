"""A CAN bus as a simulation: who sends when, exact to the bit, with errors and fault confinement.

    bus = SimulatedBus(BusTiming(500e3), [BusNodeSettings("a"), BusNodeSettings("b")])
    bus.request(0, 0, BusFrame(0x123, b"hello"))
    events = bus.advance(10**9)                       # 1 ms
    frame = bus.frame(events[events["kind"] == BusEvent.RECEIVED][0])

Time is an integer of picoseconds from the start of the simulation. The C code is in
``cosim/c/bus``; docs/bus.md says what is simulated and what is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError
from cosim.bus.frames import EVENT, BusEvent, BusFrame, ControllerState
from cosim.bus.settings import BusNodeSettings, Disturbance
from cosim.bus.timing import BusTiming


class BusSimulationError(CosimError, ValueError):
    """A request that a simulated bus cannot take, or settings that cannot be."""


class BusNodeState(NamedTuple):
    """A node's error counters, its state, and how many frames it has in its transmit queue."""

    tec: int
    rec: int
    state: ControllerState
    pending: int


class ReceivedFrame(NamedTuple):
    """A frame of a receive FIFO: when it was received, ps, and the number of its request."""

    time_ps: int
    request: int
    frame: BusFrame


class SimulatedBus:
    """A bus and its nodes, at time 0: idle, all nodes error active.

    A bit takes round(1e12 / bit rate) ps. `nodes` are numbered from 0. `record`: the kinds of
    events that are returned. Nothing depends on how the time is cut into calls of `advance`.
    """

    def __init__(
        self,
        timing: BusTiming,
        nodes: Sequence[BusNodeSettings],
        *,
        disturbances: Sequence[Disturbance] = (),
        seed: int = 0,
        record: Sequence[BusEvent] = tuple(BusEvent),
    ) -> None:
        raise NotImplementedError

    @property
    def now_ps(self) -> int:
        """Where the last `advance` went to, ps."""
        raise NotImplementedError

    def request(self, node: int, at_ps: int, frame: BusFrame) -> int:
        """Make a frame pending at a node from `at_ps` on; returns the number of the request.

        `at_ps` may be now, or later, but not before the node's last request. Requests are numbered
        from 0. A request at the time to which the bus was advanced still takes part in the
        arbitration at that time. Raises BusSimulationError for a time in the past, for more future
        requests than the node's inbox holds, and for an FD frame on a classic bus.
        """
        raise NotImplementedError

    def request_many(self, requests: NDArray[np.void]) -> int:
        """Make many frames pending: rows of ``cosim.bus.frames.REQUEST``, shape (n,), `at` in ps.

        Returns the number of the first; they are numbered on. Raises as `request`; requests before
        the one that cannot be taken are made.
        """
        raise NotImplementedError

    def abort(self, node: int, request: int) -> bool:
        """Drop a request; one that is being sent now is finished, but not repeated.

        Returns False when the request is neither pending nor being sent. The DROPPED event is in
        what the next `advance` returns.
        """
        raise NotImplementedError

    def advance(self, until_ps: int) -> NDArray[np.void]:
        """Go on to `until_ps` (ps); returns the events since, rows of ``EVENT``, shape (n,).

        Events at `until_ps` itself are among them; but a frame that could start at `until_ps`
        starts in the next call, so that a request made at that time can take part. Raises
        BusSimulationError when `until_ps` is in the past.
        """
        raise NotImplementedError

    def frame(self, event: Any) -> BusFrame:
        """The frame of a SENT or RECEIVED event of the last `advance`.

        Raises BusSimulationError for another kind of event.
        """
        raise NotImplementedError

    def received(self, node: int) -> list[ReceivedFrame]:
        """Take all frames out of a node's receive FIFO, the oldest first."""
        raise NotImplementedError

    def state(self, node: int) -> BusNodeState:
        """Error counters, state and queue of a node at `now_ps`."""
        raise NotImplementedError

    def reset(self, node: int) -> None:
        """Restart a controller: drop what is pending, clear its counters, integrate anew.

        It takes part again after 11 recessive bits; when it was bus-off, after 128 times 11.
        """
        raise NotImplementedError


def new_events() -> NDArray[np.void]:
    """No events, shape (0,)."""
    return np.empty(0, EVENT)
