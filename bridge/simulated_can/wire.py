"""The wire of a simulated channel: nodes that come and go, frames, and how busy it is.

Time is an integer of picoseconds. The bus itself is `cosim.bus.simulation`; its nodes are fixed, so
this class makes a new one when a node joins or leaves. As on a real bus, where a controller waits
for 11 recessive bits before it takes part, that is between two frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import final

from bridge.simulated_can.disturbances import Disturbances
from bridge.simulated_can.node import (
    INTERMISSION,
    Happening,
    WireNode,
    WireRecorder,
    length_ps,
    told,
)
from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import Disturbance
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming

HISTORY_S = 10
"""How long the wire remembers when it was busy, s."""
_AFTER_ERROR = 6 + 8 + INTERMISSION
"""Least bits from the detection of an error to the end of the intermission: flag, delimiter."""
_STEP = 16
"""Bits to go on while a frame waits and none is on the wire; shorter than any frame."""


@final
class CanWire:
    """One bus, from time 0 on: idle, without nodes."""

    def __init__(
        self, timing: BusTiming, disturbances: Sequence[Disturbance] = (), seed: int = 0
    ) -> None:
        self.timing = timing
        self.now_ps = 0
        self._bit_ps = round(1e12 / timing.bitrate)
        self._data_bit_ps = round(1e12 / (timing.data_bitrate or timing.bitrate))
        self._disturbances, self._seed = Disturbances(), seed
        for disturbance in disturbances:
            self._disturbances.add(disturbance, 0)
        self._bus: SimulatedBus | None = None
        self._start_ps = 0
        self._nodes: list[WireNode] = []
        self._members: list[WireNode] = []
        self._stale = False
        self._early: list[tuple[WireNode, BusFrame]] = []
        self._requests: dict[int, tuple[WireNode, BusFrame]] = {}
        self._ends: dict[WireNode, tuple[int, BusFrame]] = {}
        self._free_ps = 0
        self._troubled = False
        self._began_ps: int | None = None
        self._busy: deque[tuple[int, int]] = deque()
        self.recorder: WireRecorder | None = None
        self._recorded: dict[WireNode, int] = {}
        self._numbers: list[int] = []
        self._requested = 0
        self._offered: deque[tuple[int, WireNode, BusFrame]] = deque()

    def join(self, node: WireNode) -> None:
        """Add a node, from the end of the transmission under way on."""
        self._members.append(node)
        self._stale = True
        if self.recorder is not None:
            self._recorded[node] = self.recorder.node(node.settings.name)

    def leave(self, node: WireNode) -> None:
        """Remove a node when it has sent what it has."""
        node.leaving = True
        self._retire()

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance, from the end of the transmission under way on."""
        self._disturbances.add(disturbance, self.now_ps)
        self._stale = True

    def send(self, node: WireNode, frame: BusFrame) -> None:
        """Put a frame into the transmit queue of a node, now."""
        self._renew()
        if self._bus is None or node not in self._nodes:
            self._early.append((node, frame))
        else:
            self._request(self._bus, node, frame)

    def offer(self, frames: Iterable[tuple[int, WireNode, BusFrame]]) -> None:
        """Frames to come, by time: (when, ps, at which node, frame); not before those offered."""
        self._offered.extend(frames)

    def waiting(self, node: WireNode) -> int:
        """How many frames are in the transmit queue of a node."""
        return len(node.pending) + sum(owner is node for owner, _ in self._early)

    def abort(self, node: WireNode) -> None:
        """Drop the frames of a node that wait; one on the wire is finished."""
        self._early = [entry for entry in self._early if entry[0] is not node]
        if self._bus is not None and node in self._nodes:
            for request in list(node.pending):
                self._bus.abort(self._nodes.index(node), request)

    def reset(self, node: WireNode) -> None:
        """Restart the controller of a node; what waits is dropped."""
        self._early = [entry for entry in self._early if entry[0] is not node]
        if self._bus is not None and node in self._nodes:
            self._bus.reset(self._nodes.index(node))

    def count(self) -> None:
        """Bring the error counters of all nodes up to date."""
        for number, node in enumerate(self._nodes):
            if self._bus is not None:
                node.tec, node.rec = self._bus.state(number)[:2]

    def advance(self, until_ps: int) -> list[Happening]:
        """Go on to `until_ps` (ps); returns what happened, in the order of time."""
        found: list[Happening] = []
        while self._stale and not self._renew() and self.now_ps < until_ps:
            found += self._run(min(until_ps, self._next_gap()))
        return found + self._run(until_ps)

    def next_ps(self) -> int | None:
        """When a frame may next be received, ps: not later than it is; None: nothing is sent."""
        later = [end for end, _ in self._ends.values() if end > self.now_ps]
        if later:
            return min(later)
        recovering = any(
            node.state in (ControllerState.OFF, ControllerState.INTEGRATING)
            and node.settings.recovers
            for node in self._nodes
        )
        if recovering or self._early or any(node.pending for node in self._nodes):
            return max(self.now_ps, self._free_ps) + _STEP * self._bit_ps
        if self._offered:
            return max(self.now_ps, self._offered[0][0]) + _STEP * self._bit_ps
        return None

    def busy(self, window_ps: int) -> float:
        """The share of the last `window_ps` (ps) in which the bus was busy, 0 to 1.

        Busy is from a start of frame to the end of the intermission, also of a failed attempt.
        """
        begin = max(0, self.now_ps - window_ps)
        spans = [*self._busy, *self._current()]
        taken = sum(max(0, min(end, self.now_ps) - max(start, begin)) for start, end in spans)
        return taken / (self.now_ps - begin) if self.now_ps > begin else 0.0

    def _next_gap(self) -> int:
        """When the transmission under way may be over, ps."""
        if not self._ends and self._free_ps > self.now_ps:
            return self._free_ps
        return self.next_ps() or self.now_ps + self._bit_ps

    def _renew(self) -> bool:
        """Make the bus anew with the nodes there are now, if nothing is on the wire."""
        if not self._stale:
            return True
        if self._ends or self._troubled or self.now_ps < self._free_ps:
            return False
        self.count()
        numbers = [self._numbers[request] for request in self._requests] if self._numbers else []
        waiting = [*self._requests.values(), *self._early]
        self._requests, self._early, self._stale = {}, [], False
        self._members = [node for node in self._members if not (node.leaving and not node.pending)]
        self._nodes, self._start_ps = list(self._members), self.now_ps
        for node in self._nodes:
            node.pending = {}
        self._seed += 1
        self._numbers = []
        if not self._nodes:
            self._bus = None
            return True
        self._bus = SimulatedBus(
            self.timing,
            [
                replace(node.settings, tec=min(node.tec, 256), rec=min(node.rec, 255))
                for node in self._nodes
            ],
            disturbances=self._disturbances.left(self.now_ps),
            seed=self._seed,
        )
        for place, (node, frame) in enumerate(waiting):
            if node in self._nodes:
                known = numbers[place] if place < len(numbers) else None
                self._request(self._bus, node, frame, known)
        return True

    def _retire(self) -> None:
        """Whether a node can go now: the bus is made anew without it."""
        if any(node.leaving and not self.waiting(node) for node in self._members):
            self._stale = True

    def _feed(self, bus: SimulatedBus, until_ps: int) -> None:
        """Request what was offered for times before `until_ps` (ps)."""
        while self._offered and self._offered[0][0] < until_ps:
            at_ps, node, frame = self._offered.popleft()
            if node in self._nodes:
                self._request(bus, node, frame, at_ps=at_ps)

    def _request(
        self,
        bus: SimulatedBus,
        node: WireNode,
        frame: BusFrame,
        known: int | None = None,
        at_ps: int = 0,
    ) -> None:
        """Make a request, now or later; `known`: its number for the recorder, if it was made."""
        at_ps = max(at_ps, self.now_ps)
        request = bus.request(self._nodes.index(node), at_ps - self._start_ps, frame)
        node.pending[request] = frame
        self._requests[request] = (node, frame)
        if self.recorder is None:
            return
        if known is None:
            known, self._requested = self._requested, self._requested + 1
            self.recorder.request(known, at_ps, self._recorded[node], frame)
        self._numbers.append(known)

    def _run(self, until_ps: int) -> list[Happening]:
        if self._bus is not None:
            self._feed(self._bus, until_ps)
        self.now_ps = max(self.now_ps, until_ps)
        if self._bus is None:
            return []
        events = self._bus.advance(self.now_ps - self._start_ps)
        if self.recorder is not None:
            nodes = [self._recorded[node] for node in self._nodes]
            self.recorder.add(told(events, self._start_ps, nodes, self._numbers), self.now_ps)
        rows = events.tolist()
        found = []
        for place, row in enumerate(rows):
            if row[7] == BusEvent.FREE:
                self._free_ps, self._troubled = row[0] + self._start_ps, False
                continue
            happening = self._read(*row[:10])
            if row[2] >= 0 and happening.frame and happening.frame.format.fd:
                sent = self._bus.frame(events[place])  # with the ESI of its sender
                happening = happening._replace(frame=sent)
            found.append(happening)
        for row in rows:
            if row[7] in (BusEvent.SENT, BusEvent.DROPPED):
                self._requests.pop(row[1], None)
        self._ends = {n: last for n, last in self._ends.items() if last[0] > self.now_ps}
        self._retire()
        oldest = self.now_ps - HISTORY_S * 10**12
        while self._busy and self._busy[0][1] < oldest:
            self._busy.popleft()
        return found

    def _read(
        self,
        time: int, request: int, _frame: int, bit: int, number: int,
        tec: int, rec: int, kind: int, code: int, role: int,
    ) -> Happening:  # fmt: skip
        time_ps, node = time + self._start_ps, self._nodes[number]
        node.tec, node.rec = tec, rec
        known = self._requests.get(request)
        event = BusEvent(kind)
        self._follow(event, time_ps, node, known)
        if event == BusEvent.STATE:
            node.state = ControllerState(code)
        elif event == BusEvent.RECOVERED:
            node.state = ControllerState.ACTIVE
        elif event in (BusEvent.SENT, BusEvent.DROPPED):
            node.pending.pop(request, None)
        return Happening(time_ps, node, event, code, role, bit, known[1] if known else None)

    def _follow(
        self, event: BusEvent, time_ps: int, node: WireNode, known: tuple[WireNode, BusFrame] | None
    ) -> None:
        """Who is on the wire until when, and from when on it is free."""
        if event == BusEvent.STARTED:
            if not self._ends:
                self._busy.extend(self._current())
                self._began_ps = time_ps
            if known:
                self._ends[node] = (
                    time_ps + length_ps(known[1], self._bit_ps, self._data_bit_ps),
                    known[1],
                )
        elif event == BusEvent.LOST:
            self._ends.pop(node, None)
        elif event in (BusEvent.SENT, BusEvent.ERROR, BusEvent.OVERLOAD):
            for _, frame in self._ends.values():
                self._disturbances.attempted(frame)
            self._ends.clear()
            self._troubled |= event != BusEvent.SENT
            after = _AFTER_ERROR if self._troubled else INTERMISSION
            self._free_ps = time_ps + after * self._bit_ps

    def _current(self) -> list[tuple[int, int]]:
        """The transmission that began last, as far as it is known."""
        if self._began_ps is None:
            return []
        under_way = self._ends or self._troubled
        return [(self._began_ps, self.now_ps if under_way else self._free_ps)]
