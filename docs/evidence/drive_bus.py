"""A bus with drives that answer commands, as the host of the drives sees it.

Each drive answers a command with one frame, after its turn-around time. It has one mailbox for
that, in which a newer answer replaces an older one that is still waiting. The host writes commands
and reads answers; each direction of its adapter takes a latency.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings, QueueKind
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat

#: Identifier with which all drives are asked for their state; it loses against their answers.
REFRESH = 0x7FF


@dataclass(frozen=True, slots=True)
class DriveBus:
    """A bus with drives 1 to `drives`: identifiers i of commands and 0x10 + i of answers, 8 bytes.

    `turn_around`: from the end of a command to the answer's readiness, s; `latency`: of the host's
    adapter, s, in each direction; `spacing`: the host gets no two answers closer together than
    this, s, because the adapter delivers them one by one; `queue`, `queue_length`: order and number
    of the host's frames that wait, more are lost; `seed`: of the bytes, which decide the stuff
    bits.
    """

    drives: int
    timing: BusTiming
    format: FrameFormat = CLASSIC
    turn_around: float = 30e-6
    latency: float = 0.0
    spacing: float = 0.0
    queue: QueueKind = QueueKind.SORTED
    queue_length: int = 1024
    seed: int = 0


@final
class Answer(NamedTuple):
    """Time (ps) at which the host can read an answer, its drive, and the time of its state."""

    at: int
    drive: int
    sampled: int


@final
class HeardCommand(NamedTuple):
    """Time (ps) at which a drive heard a command, the command, and the host's note on it."""

    at: int
    drive: int
    tag: object


@final
class DrivenBus:
    """The bus as the host sees it; times in ps.

    `arrived`: answers for the host, the oldest first; `heard`: commands that drives heard; `sent`,
    `answers`: commands and answers so far; `busy`: how long the bus was, ps.
    """

    def __init__(self, spec: DriveBus) -> None:
        nodes = [BusNodeSettings("host", spec.queue, spec.queue_length)]
        nodes += [BusNodeSettings(f"drive {i + 1}", queue_length=2) for i in range(spec.drives)]
        kinds = (BusEvent.STARTED, BusEvent.SENT)
        self._bus = SimulatedBus(spec.timing, nodes, record=kinds, seed=spec.seed)
        self._spec, self._random = spec, np.random.default_rng(spec.seed)
        self._pending: dict[int, int] = {}  # request of the answer that waits, by node
        self._asked: dict[int, tuple[int, object]] = {}  # drive and tag of a command, by request
        self._taken: dict[int, int] = {}  # when the state in an answer was taken, by request
        self._step = round(spec.turn_around * 1e12)
        self._intermission = round(3e12 / spec.timing.bitrate)
        self.latency = round(spec.latency * 1e12)
        self._spacing = round(spec.spacing * 1e12)
        self._delivered = -self._spacing  # when the host got the last answer
        self.arrived: deque[Answer] = deque()
        self.heard: list[HeardCommand] = []
        self.sent = self.answers = self.busy = 0
        self._begun = 0

    def command(self, at: int, drive: int, *, refresh: bool = False, tag: object = None) -> None:
        """Write a command for a drive, or ask it for its state, at the host's time `at`."""
        identifier = REFRESH if refresh else drive
        ready = max(at + self.latency, self._bus.now_ps)
        self._asked[self._bus.request(0, ready, self._frame(identifier))] = drive, tag
        self.sent += 1

    def advance(self, until: int) -> None:
        """Simulate to `until`; drives answer what they have heard."""
        while self._bus.now_ps < until:
            for event in self._bus.step(min(until, self._bus.now_ps + self._step)):
                time, request, node, kind = event[0], event[1], event[4], event[7]
                if kind == BusEvent.STARTED:
                    self._begun = time
                    continue
                self.busy += time - self._begun + self._intermission
                if node == 0:
                    self._answer(*self._asked.pop(request), time)
                    continue
                self.answers += 1
                self._delivered = max(time + self.latency, self._delivered + self._spacing)
                self.arrived.append(Answer(self._delivered, node, self._taken.pop(request)))
                if self._pending[node] == request:
                    del self._pending[node]

    def _answer(self, drive: int, tag: object, heard: int) -> None:
        self.heard.append(HeardCommand(heard, drive, tag))
        if (waiting := self._pending.get(drive)) is not None:
            self._bus.abort(drive, waiting)  # the newest wins; what is being sent is finished
        ready = max(heard + self._step, self._bus.now_ps)
        request = self._bus.request(drive, ready, self._frame(0x10 + drive))
        self._pending[drive] = request
        self._taken[request] = heard

    def _frame(self, identifier: int) -> BusFrame:
        return BusFrame(identifier, self._random.bytes(8), self._spec.format)

    def wait(self, now: int, timeout: int) -> Answer | None:
        """The next answer for a call at `now`, which waits for `timeout`; None without one."""
        while not self.arrived or self.arrived[0].at > now + timeout:
            if self._bus.now_ps >= now + timeout:
                return None
            self.advance(min(now + timeout, self._bus.now_ps + self._step))
        return self.arrived.popleft()
