"""A scenario's bus that is simulated inside the ticks, because frames carry the values of signals.

The bus is a gate of the engine at each sender and receiver: C, without Python and without
allocation in a tick (``cosim/c/bus/tick.h``). Requests that do not depend on values are known
before the run and handed to the bus at their times.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.bus.frames import EVENT, FRAME, REQUEST, BusEvent
from cosim.bus.settings import FrameEncoding
from cosim.bus.shared import tick_gates
from cosim.bus.simulation import SimulatedBus
from cosim.bus.structs import (
    BusOutputStruct,
    TickBusStruct,
    TickFrameStruct,
    TickGateStruct,
    TickReceiverStruct,
)
from cosim.scenario.bus_frames import PS, FrameOnBus
from cosim.scenario.buses import listening, prepared_bus
from cosim.scenario.connect import ScenarioComponents
from cosim.schedule.parts import Gate, Link


@dataclass(frozen=True, slots=True)
class SentFrame:
    """A frame of a link: `request` without data, a row of ``REQUEST``; `offset_ps` after a sample.

    `places`: of its values in the signals. `samples`: how many a run sends at most; `waiting`: how
    many may not have reached the bus yet. Without an encoding its requests are known before.
    """

    gate: Gate
    request: NDArray[np.void]
    offset_ps: int
    samples: int
    waiting: int
    places: tuple[int, ...]
    encoding: FrameEncoding
    scale: float


@dataclass(frozen=True, slots=True)
class ReceivedLink:
    """A link that receives a frame, by the numbers of frame and node."""

    name: str
    gate: Gate
    frame: int
    node: int


@final
@dataclass(frozen=True, slots=True)
class BusInTicks:
    """A bus of a plan: `new` makes it at time 0; `known` requests by time, of frames or others.

    `owners`: of each known request the number of its frame, or how many frames there are.
    """

    name: str
    new: Callable[[], SimulatedBus]
    step_ps: int
    frames: tuple[SentFrame, ...]
    received: tuple[ReceivedLink, ...]
    known: NDArray[np.void]
    owners: NDArray[np.int32]

    @property
    def gates(self) -> tuple[Gate, ...]:
        """The places of the bus in a tick: behind its senders and before its receivers."""
        sent = tuple(f.gate for f in self.frames if f.encoding)
        return sent + tuple(link.gate for link in self.received)

    @property
    def history(self) -> Mapping[str, int]:
        """The number of samples each link keeps: all, since a frame may wait for any time."""
        return {link.name: self.frames[link.frame].samples for link in self.received}

    def start(self) -> RunningBusInTicks:
        """The bus of one execution."""
        return RunningBusInTicks(self)


@final
class RunningBusInTicks:
    """One execution of a :class:`BusInTicks`: memory that C works on.

    `gates`: (address of the function, of its context) by the name of the gate.
    """

    def __init__(self, bus: BusInTicks) -> None:
        self._bus, frames = bus.new(), bus.frames
        self._alive: list[Any] = [self._bus]
        total = len(bus.known) + sum(f.samples for f in frames if f.encoding)
        numbers = np.zeros((2, total), np.int32)
        rows = 8 * len(self._bus.nodes) + 64
        room = np.empty(rows, EVENT), np.empty(rows, FRAME)
        self._frames = (TickFrameStruct * max(1, len(frames)))(*(self._frame(f) for f in frames))
        self._receivers = (TickReceiverStruct * max(1, len(bus.received)))(
            *(TickReceiverStruct(frame=r.frame, node=r.node, held=-1) for r in bus.received)
        )
        self._struct = TickBusStruct(
            bus=self._bus.address,
            frames=c.addressof(self._frames),
            receivers=c.addressof(self._receivers),
            known=bus.known.ctypes.data,
            owners=bus.owners.ctypes.data,
            frame_of=numbers[0].ctypes.data,
            sample_of=numbers[1].ctypes.data,
            output=BusOutputStruct(room[0].ctypes.data, room[1].ctypes.data, rows, rows),
            step=bus.step_ps,
            n_known=len(bus.known),
            room=total,
            room_events=rows,
            n_frames=len(frames),
            n_receivers=len(bus.received),
        )
        self._alive += [bus, numbers, room]
        self._index = {link.name: i for i, link in enumerate(bus.received)}
        send, receive = tick_gates()
        self.gates: dict[str, tuple[int, int]] = {}
        for i, frame in enumerate(frames):
            if frame.encoding:
                self.gates[frame.gate.name] = send, self._context(i)
        for i, link in enumerate(bus.received):
            self.gates[link.gate.name] = receive, self._context(i)

    def rows(self, link: str, n: int) -> NDArray[np.int32]:
        """Room for the next `n` rows of a link's table, (n,), which the run fills in."""
        rows = np.full(n, -1, np.int32)
        receiver = self._receivers[self._index[link]]
        receiver.table, receiver.row = rows.ctypes.data, 0
        return rows

    def _frame(self, f: SentFrame) -> TickFrameStruct:
        waiting, places = np.zeros(f.waiting, REQUEST), np.array(f.places or (0,), np.int64)
        self._alive += [waiting, places]
        return TickFrameStruct(
            pending=waiting.ctypes.data,
            request=f.request.ctypes.data,
            places=places.ctypes.data,
            scale=f.scale,
            offset=f.offset_ps,
            room=len(waiting),
            n_places=len(f.places),
            encoding=f.encoding,
        )

    def _context(self, index: int) -> int:
        gate = TickGateStruct(bus=c.addressof(self._struct), index=index)
        self._alive.append(gate)
        return c.addressof(gate)


def bus_in_ticks(
    parts: ScenarioComponents,
    name: str,
    frames: Sequence[FrameOnBus],
    links: Sequence[tuple[Link, str, str]],
) -> BusInTicks:
    """The bus `name` of a scenario; `links`: each with the name of its frame and its receiver.

    Raises ScenarioError.
    """
    for link, _, _ in links:
        said = link.table.facts()["semantics"]
        if said not in ("newest-stamp", "last-arrival"):
            raise ScenarioError(
                f"bus {name}, link {link.name}: found semantics {said} on a bus that is simulated"
                " in the tick, expected newest-stamp or last-arrival"
            )
    step = round(parts.h * PS)
    length = step * (parts.ticks + 1)
    fixed = [replace(f, period_ps=2 * length) if f.encoding else f for f in frames]
    prepared = prepared_bus(
        parts.scenario, name, fixed, length, (BusEvent.RECEIVED,), listening(frames)
    )
    index = {f.name: i for i, f in enumerate(frames)}
    kept = ~np.isin(prepared.owner, [i for i, f in enumerate(frames) if f.encoding])
    owners = np.where(prepared.owner < 0, len(frames), prepared.owner)[kept].astype(np.int32)
    look = step * max(parts.steps[receiver].period for _, _, receiver in links)
    return BusInTicks(
        name=name,
        new=prepared.new,
        step_ps=step,
        frames=tuple(_sent(name, f, prepared.names.index(f.sender), length, look) for f in frames),
        received=tuple(
            ReceivedLink(
                link.name,
                Gate(f"bus {name}: {link.name}", receiver, out=False),
                index[frame],
                prepared.names.index(receiver),
            )
            for link, frame, receiver in links
        ),
        known=prepared.requests[kept],
        owners=owners,
    )


def _sent(bus: str, f: FrameOnBus, node: int, length_ps: int, look_ps: int) -> SentFrame:
    places = tuple(i for slot in f.sources for i in range(slot.start, slot.start + slot.size))
    size = len(places) * f.encoding.size
    if size > f.frame.length:
        raise ScenarioError(
            f"bus {bus}, frame {f.name}: found {f.frame.length} bytes, expected {size} for"
            f" {len(places)} values as {f.encoding.name.lower()}"
        )
    request = np.zeros(1, REQUEST)
    request["node"], request["frame"] = node, replace(f.frame, data=bytes(f.frame.length)).row()
    return SentFrame(
        gate=Gate(f"bus {bus}: frame {f.name}", f.sender, out=True),
        request=request,
        offset_ps=f.offset_ps,
        samples=length_ps // f.period_ps + 2,
        waiting=(f.offset_ps + look_ps) // f.period_ps + 2,
        places=places,
        encoding=f.encoding,
        scale=f.scale,
    )
