"""The wire of a simulated channel: nodes that come and go, frames, and how busy it is.

Time is an integer of picoseconds. The bus itself is `cosim.bus.simulation`; its nodes are fixed, so
this class makes a new one when a node joins or leaves. As on a real bus, where a controller waits
for 11 recessive bits before it takes part, that is between two frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import final

from bridge.simulated_can.busy_time import BusyTime
from bridge.simulated_can.disturbances import Disturbances
from bridge.simulated_can.node import Happening, WireNode, WireRecorder, told
from cosim.base.copies import replace
from cosim.bus.frames import BusEvent, BusFrame, ControllerState
from cosim.bus.settings import Disturbance
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming

_STEP = 16
"""Bits to go on while a frame waits and none is on the wire; shorter than any frame."""

_STARTED, _SENT, _RECEIVED, _DROPPED, _FREE = (
    int(kind)
    for kind in (
        BusEvent.STARTED, BusEvent.SENT, BusEvent.RECEIVED, BusEvent.DROPPED, BusEvent.FREE,
    )
)  # fmt: skip


@final
class CanWire:
    """One bus, from time 0 on: idle, without nodes."""

    def __init__(
        self, timing: BusTiming, disturbances: Sequence[Disturbance] = (), seed: int = 0
    ) -> None:
        self.timing = timing
        self.now_ps = 0
        self._bit_ps = round(1e12 / timing.bitrate)
        self._busy = BusyTime(timing)
        self._disturbances, self._seed = Disturbances(), seed
        for disturbance in disturbances:
            self._disturbances.add(disturbance, 0)
        self._bus: SimulatedBus | None = None
        self._start_ps = 0
        self._nodes: list[WireNode] = []
        self._places: dict[WireNode, int] = {}
        self._members: list[WireNode] = []
        self._stale = self._leaving = False
        self._early: list[tuple[WireNode, BusFrame]] = []
        self._requests: dict[int, tuple[WireNode, BusFrame]] = {}
        self.recorder: WireRecorder | None = None
        self._recorded: dict[WireNode, int] = {}
        self._numbers: dict[int, int] = {}
        self._requested = 0
        self._offered: deque[tuple[int, WireNode, BusFrame]] = deque()

    def record(self, recorder: WireRecorder | None) -> None:
        """Tell `recorder` of the nodes there are, and from now on of requests and events."""
        self.recorder, self._numbers = recorder, {}
        self._recorded = {}
        if recorder is not None:
            self._recorded = {node: recorder.node(node.settings.name) for node in self._members}

    def join(self, node: WireNode) -> None:
        """Add a node, from the end of the transmission under way on."""
        self._members.append(node)
        self._stale = True
        if self.recorder is not None:
            self._recorded[node] = self.recorder.node(node.settings.name)

    def leave(self, node: WireNode) -> None:
        """Remove a node when it has sent what it has."""
        node.leaving = self._leaving = True
        self._retire()

    def disturb(self, disturbance: Disturbance) -> None:
        """Add a disturbance, from the end of the transmission under way on."""
        self._disturbances.add(disturbance, self.now_ps)
        self._stale = True

    def send(self, node: WireNode, frame: BusFrame) -> None:
        """Put a frame into the transmit queue of a node, now."""
        if self._stale:
            self._renew()
        if self._bus is None or node not in self._places:
            self._early.append((node, frame))
        else:
            self._request(self._bus, node, frame)

    def offer(self, frames: Iterable[tuple[int, WireNode, BusFrame]]) -> None:
        """Frames to come, by time: (when, ps, at which node, frame); not before those offered."""
        self._offered.extend(frames)

    def waiting(self, node: WireNode) -> int:
        """The number of frames in the transmit queue of a node."""
        early = sum(owner is node for owner, _ in self._early) if self._early else 0
        return len(node.pending) + early

    def abort(self, node: WireNode) -> None:
        """Drop the frames of a node that wait; one on the wire is finished."""
        self._early = [entry for entry in self._early if entry[0] is not node]
        if self._bus is not None and node in self._places:
            for request in list(node.pending):
                self._bus.abort(self._places[node], request)

    def reset(self, node: WireNode) -> None:
        """Restart the controller of a node; what waits is dropped."""
        self._early = [entry for entry in self._early if entry[0] is not node]
        if self._bus is not None and node in self._places:
            self._bus.reset(self._places[node])

    def count(self) -> None:
        """Bring the error counters of all nodes up to date."""
        for number, node in enumerate(self._nodes):
            if self._bus is not None:
                node.tec, node.rec = self._bus.state(number)[:2]

    def advance(self, until_ps: int) -> list[Happening]:
        """Go on to `until_ps` (ps); returns what happened, in the order of time."""
        if not self._stale:
            return self._run(until_ps)
        found: list[Happening] = []
        while not self._renew() and self.now_ps < until_ps:
            found += self._run(min(until_ps, self._next_gap()))
        return found + self._run(until_ps)

    def next_ps(self) -> int | None:
        """The next time at which a frame may be received, ps: never too late; None: nothing is
        sent.
        """
        busy = self._busy
        if busy.sending:
            end = busy.next_end(self.now_ps)
            if end is not None:
                return end
        if len(self._requests) == 1 and not self._early and not self._offered:
            _, frame = next(iter(self._requests.values()))
            return max(self.now_ps, busy.free_ps) + busy.length_ps(frame)
        if self._early or any(node.pending or node.recovering for node in self._nodes):
            return max(self.now_ps, busy.free_ps) + _STEP * self._bit_ps
        if self._offered:
            return max(self.now_ps, self._offered[0][0]) + _STEP * self._bit_ps
        return None

    def busy(self, window_ps: int) -> float:
        """The share of the last `window_ps` (ps) in which the bus was busy, 0 to 1.

        Busy is from a start of frame to the end of the intermission, also of a failed attempt.
        """
        return self._busy.share(self.now_ps, window_ps)

    def _next_gap(self) -> int:
        """The time at which the transmission under way may be over, ps."""
        if not self._busy.sending and self._busy.free_ps > self.now_ps:
            return self._busy.free_ps
        return self.next_ps() or self.now_ps + self._bit_ps

    def _renew(self) -> bool:
        """Make the bus anew with the nodes there are now, if nothing is on the wire."""
        if not self._stale:
            return True
        if self._busy.under_way or self.now_ps < self._busy.free_ps:
            return False
        self.count()
        numbers = [self._numbers.get(request) for request in self._requests]
        numbers += [None] * len(self._early)
        waiting = [*self._requests.values(), *self._early]
        self._requests, self._early, self._stale = {}, [], False
        self._members = [node for node in self._members if not (node.leaving and not node.pending)]
        self._leaving = any(node.leaving for node in self._members)
        self._nodes, self._start_ps = list(self._members), self.now_ps
        self._places = {node: place for place, node in enumerate(self._nodes)}
        for node in self._nodes:
            node.pending = {}
        self._seed += 1
        self._numbers = {}
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
        for (node, frame), known in zip(waiting, numbers, strict=True):
            if node in self._places:
                self._request(self._bus, node, frame, known)
        return True

    def _retire(self) -> None:
        """True if a node can go now: the bus is made anew without it."""
        if self._leaving and any(n.leaving and not self.waiting(n) for n in self._members):
            self._stale = True

    def _feed(self, bus: SimulatedBus, until_ps: int) -> None:
        """Request what was offered for times before `until_ps` (ps)."""
        while self._offered and self._offered[0][0] < until_ps:
            at_ps, node, frame = self._offered.popleft()
            if node in self._places:
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
        if at_ps < self.now_ps:
            at_ps = self.now_ps
        request = bus.request(self._places[node], at_ps - self._start_ps, frame)
        node.pending[request] = frame
        self._requests[request] = (node, frame)
        if self.recorder is None:
            return
        if known is None:
            known, self._requested = self._requested, self._requested + 1
            self.recorder.request(known, at_ps, self._recorded[node], frame)
        self._numbers[request] = known

    def _run(self, until_ps: int) -> list[Happening]:
        bus = self._bus
        if bus is not None and self._offered:
            self._feed(bus, until_ps)
        if until_ps > self.now_ps:
            self.now_ps = until_ps
        if bus is None:
            return []
        rows = bus.step(self.now_ps - self._start_ps)
        if self.recorder is not None:
            nodes = [self._recorded[node] for node in self._nodes]
            self.recorder.add(told(rows, self._start_ps, nodes, self._numbers), self.now_ps)
        return self._read(bus, rows) if rows else []

    def _read(self, bus: SimulatedBus, rows: list[tuple[int, ...]]) -> list[Happening]:
        """The meaning of events for their nodes, without events of which no program is told."""
        found: list[Happening] = []
        over: list[int] = []
        for time, request, frame, bit, number, tec, rec, kind, code, role, _ in rows:
            time_ps = time + self._start_ps
            if kind == _FREE:
                self._busy.free(time_ps)
                continue
            node = self._nodes[number]
            node.tec, node.rec = tec, rec
            known = self._requests.get(request)
            sent = known[1] if known else None
            if kind == _STARTED:
                self._busy.start(time_ps, node, sent)
                continue
            if kind == _SENT:
                self._end(time_ps, False)
                node.pending.pop(request, None)
                over.append(request)
            elif kind != _RECEIVED:
                self._change(node, kind, code, request, time_ps)
                if kind == _DROPPED:
                    over.append(request)
            if frame >= 0 and sent is not None and sent.format.fd:
                sent = bus.frame_of_row(frame)  # with the ESI of its sender
            found.append((time_ps, node, kind, code, role, bit, sent))
        for request in over:  # only now: a frame is received after it was sent
            self._requests.pop(request, None)
            if self._numbers:
                self._numbers.pop(request, None)
        self._busy.forget(self.now_ps)
        if self._leaving:
            self._retire()
        return found

    def _change(self, node: WireNode, kind: int, code: int, request: int, time_ps: int) -> None:
        """Follow an event that is neither the begin nor the end of a frame."""
        if kind == BusEvent.LOST:
            self._busy.lose(node)
        elif kind == BusEvent.ERROR or kind == BusEvent.OVERLOAD:
            self._end(time_ps, True)
        elif kind == BusEvent.STATE:
            node.state = ControllerState(code)
        elif kind == BusEvent.RECOVERED:
            node.state = ControllerState.ACTIVE
        elif kind == BusEvent.DROPPED:
            node.pending.pop(request, None)

    def _end(self, time_ps: int, failed: bool) -> None:
        """A transmission is over."""
        for attempted in self._busy.end(time_ps, failed):
            self._disturbances.attempted(attempted)
