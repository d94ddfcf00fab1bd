"""Simulation of a CAN bus, exact to the bit: arbitration, errors and fault confinement.

    bus = SimulatedBus(BusTiming(500e3), [BusNodeSettings("a"), BusNodeSettings("b")])
    bus.request(0, 0, BusFrame(0x123, b"hello"))
    events = bus.advance(10**9)                       # 1 ms
    frame = bus.frame(events[events["kind"] == BusEvent.RECEIVED][0])

Time is an integer number of picoseconds from the start of the simulation. The C code is in
``cosim/c/bus``; docs/bus.md lists what is simulated and what is not.

Source: ISO 11898-1:2015; Bosch, CAN Specification 2.0 (1991), part B, section 8 (confinement).
"""

from __future__ import annotations

import ctypes as c
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cosim.bus.described import BusSimulationError, DescribedBus
from cosim.bus.frames import (
    EVENT,
    FRAME,
    RECEIVED,
    REQUEST,
    BusEvent,
    BusFrame,
    ControllerState,
    frame_of,
    frame_of_fields,
)
from cosim.bus.settings import BusNodeSettings, Disturbance
from cosim.bus.shared import library
from cosim.bus.structs import BitsStruct, BusNodeStateStruct, BusOutputStruct
from cosim.bus.timing import BusTiming

_EVENT = struct.Struct("<qqihhhhBBBB")
_FRAME = struct.Struct("<IBBH64s")
_REQUEST = struct.Struct("<qiiIBBH64s")
_FD_ON_CLASSIC = "found an FD frame on a classic bus, expected one with fd"


class BitCounter:
    """Counts the bits of frames, as ``cosim.bus.timing.frame_bits``; by C, for one thread."""

    def __init__(self) -> None:
        self._found = BitsStruct()
        self._there, self._count = c.byref(self._found), library().bus_frame_bits

    def bits(self, frame: BusFrame) -> tuple[int, int]:
        """Bits at the nominal and at the data bit rate."""
        kind, data = frame.format, frame.data
        length = frame.dlc if kind.remote else len(data)
        self._count(_FRAME.pack(frame.identifier, kind.flags, length, 0, data), self._there)
        return self._found.nominal, self._found.data


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
    """A bus and its nodes, at time 0: idle, all nodes with the counters of their settings.

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
        self.timing = timing
        self.nodes = tuple(nodes)
        described = DescribedBus(timing, nodes, disturbances, seed, record)
        self._c = library()
        settings = c.byref(described.struct)
        self._memory = np.zeros(self._c.bus_size(settings) + 16, np.uint8)
        start = self._memory.ctypes.data
        self._bus = self._c.bus_create(start + -start % 16, settings)
        self._make_room(8 * len(nodes) + 1024)
        self._now = 0
        self._frames = b""
        self._more = False
        self._requests = 0

    @property
    def now_ps(self) -> int:
        """The time of the last `advance`, ps."""
        return self._now

    @property
    def address(self) -> int:
        """The address of C's ``bus_t``, for C code that steps this bus; valid while this exists."""
        return int(self._bus)

    @property
    def whole_frames(self) -> int:
        """The number of transmissions computed as a whole so far, not bit by bit."""
        return int(self._c.bus_whole_frames(self._bus))

    def request(self, node: int, at_ps: int, frame: BusFrame) -> int:
        """Make a frame pending at a node from `at_ps` on; returns the number of the request.

        `at_ps` may be now, or later, but not before the node's last request. Requests are numbered
        from 0. A request at the time to which the bus was advanced still takes part in the
        arbitration at that time. Raises BusSimulationError for a time in the past, for more future
        requests than the node's inbox holds, and for an FD frame on a classic bus.
        """
        kind, data = frame.format, frame.data
        if kind.fd and not self.timing.fd:
            raise BusSimulationError(_FD_ON_CLASSIC)
        length = frame.dlc if kind.remote else len(data)
        row = _REQUEST.pack(at_ps, node, 0, frame.identifier, kind.flags, length, 0, data)
        if not self._c.bus_request(self._bus, row, 1):
            raise BusSimulationError(self._refused(np.frombuffer(row, REQUEST)[0]))
        self._requests += 1
        return self._requests - 1

    def request_many(self, requests: NDArray[np.void]) -> int:
        """Make many frames pending: rows of ``cosim.bus.frames.REQUEST``, shape (n,), `at` in ps.

        Returns the number of the first; they are numbered on. Raises BusSimulationError as
        `request` does; requests before the one that cannot be taken are made.
        """
        rows = np.ascontiguousarray(requests, REQUEST)
        if not self.timing.fd and (rows["frame"]["flags"] & 1).any():
            raise BusSimulationError(_FD_ON_CLASSIC)
        first = self._requests
        taken = self._c.bus_request(self._bus, rows.ctypes.data, len(rows))
        self._requests += taken
        if taken < len(rows):
            raise BusSimulationError(self._refused(rows[taken]))
        return first

    def abort(self, node: int, request: int) -> bool:
        """Drop a request; one that is being sent now is finished, but not repeated.

        Returns False when the request is neither pending nor being sent. The DROPPED event is in
        what the next `advance` returns.
        """
        return bool(self._c.bus_abort(self._bus, self._node(node), request))

    def advance(self, until_ps: int) -> NDArray[np.void]:
        """Simulate until `until_ps` (ps); return the events since the last call, ``EVENT`` (n,).

        Events at `until_ps` itself are included; but a frame that could start at `until_ps` starts
        in the next call, so that a request made at that time can take part. Raises
        BusSimulationError if `until_ps` is in the past.
        """
        events, more = [], True
        while more:
            n_events, before, more = self._part(until_ps)
            part = self._room[0][:n_events].copy()
            if before:
                part["frame"][part["frame"] >= 0] += before
            events.append(part)
        return events[0] if len(events) == 1 else np.concatenate(events)

    def step(self, until_ps: int) -> list[tuple[int, ...]]:
        """Advance and return tuples with the fields of ``EVENT``: quicker for few events."""
        events: list[tuple[int, ...]] = []
        more = True
        while more:
            n_events, before, more = self._part(until_ps)
            part = _EVENT.iter_unpack(self._bytes[0][: n_events * _EVENT.size])
            if before:
                part = ((*e[:2], e[2] + before if e[2] >= 0 else -1, *e[3:]) for e in part)
            events += part
        return events

    def _part(self, until_ps: int) -> tuple[int, int, bool]:
        """Simulate until `until_ps` (ps), or until the buffer is full, then with more room.

        Returns the number of events in the buffer, that of the frames before theirs, and True if
        there are more. Raises BusSimulationError if `until_ps` is in the past.
        """
        if until_ps < self._now:
            raise BusSimulationError(f"found {until_ps} ps, expected {self._now} ps (now) or later")
        if not self._more:
            self._frames = b""
        elif self._rows < 1 << 18:
            self._make_room(4 * self._rows)
        output = self._output
        output.n_events = output.n_frames = self._rows
        self._more = more = bool(self._c.bus_advance(self._bus, until_ps, self._there))
        before, n_frames = len(self._frames) // _FRAME.size, output.n_frames
        if n_frames:
            self._frames += self._bytes[1][: n_frames * _FRAME.size]
        if not more:
            self._now = until_ps
        return output.n_events, before, more

    def _make_room(self, rows: int) -> None:
        self._room = np.empty(rows, EVENT), np.empty(rows, FRAME)
        events, frames = (room.ctypes.data for room in self._room)
        self._rows, self._output = rows, BusOutputStruct(events, frames, rows, rows)
        self._there = c.byref(self._output)
        self._bytes = tuple(room.view(np.uint8).data for room in self._room)

    def next_event(self, until_ps: int, kinds: Sequence[BusEvent] = tuple(BusEvent)) -> int:
        """Time of the next event of these kinds without further requests, ps.

        Returns `until_ps` if there is none before. Takes as long as `advance` to that time, and
        does not change the bus. Raises BusSimulationError if `until_ps` is in the past.
        """
        before = self._memory.copy(), self._now, self._frames
        events = self.advance(until_ps)
        self._memory[:], self._now, self._frames = before
        times = events["time"][np.isin(events["kind"], np.array(kinds, np.uint8))]
        return int(times.min(initial=until_ps))

    def frame(self, event: Any) -> BusFrame:
        """The frame of a SENT or RECEIVED event of the last `advance`.

        Raises BusSimulationError for another kind of event.
        """
        return self.frame_of_row(int(event["frame"]))

    def frame_of_row(self, row: int) -> BusFrame:
        """Return the frame of the field `frame` of an event of the last `advance` or `step`.

        Raises BusSimulationError for another row.
        """
        if not 0 <= row < len(self._frames) // _FRAME.size:
            raise BusSimulationError(
                f"found an event with frame {row}, expected one of the last call"
            )
        identifier, flags, length, _, data = _FRAME.unpack_from(self._frames, row * _FRAME.size)
        return frame_of_fields(identifier, flags, length, data)

    def received(self, node: int) -> list[ReceivedFrame]:
        """Take all frames out of a node's receive FIFO, the oldest first."""
        rows = np.empty(self.nodes[self._node(node)].receive_length, RECEIVED)
        count = self._c.bus_receive(self._bus, node, rows.ctypes.data, len(rows))
        return [
            ReceivedFrame(int(r["time"]), int(r["request"]), frame_of(r["frame"]))
            for r in rows[:count]
        ]

    def state(self, node: int) -> BusNodeState:
        """Error counters, state and queue of a node at `now_ps`."""
        found = BusNodeStateStruct()
        self._c.bus_state(self._bus, self._node(node), c.byref(found))
        return BusNodeState(found.tec, found.rec, ControllerState(found.state), found.pending)

    def reset(self, node: int) -> None:
        """Restart a controller: drop what is pending, clear its counters, integrate anew.

        It takes part again after 11 recessive bits; when it was bus-off, after 128 times 11.
        """
        self._c.bus_reset(self._bus, self._node(node))

    def _node(self, node: int) -> int:
        if not 0 <= node < len(self.nodes):
            raise BusSimulationError(f"found node {node}, expected 0 to {len(self.nodes) - 1}")
        return node

    def _refused(self, row: Any) -> str:
        """The reason why the bus did not take a request."""
        node, at = int(row["node"]), int(row["at"])
        name = self.nodes[self._node(node)].name
        if at < self._now:
            return f"node {name}: found a request at {at} ps, expected {self._now} ps or later"
        return (
            f"node {name}: found a request at {at} ps that does not fit, expected requests in the"
            f" order of time, at most {self.nodes[node].inbox} in advance, of frames that CAN has"
        )
