"""A program that commands drives over a simulated bus: what its blocking reads make of it.

Each drive answers a command with one frame, after its turn-around time. It has one mailbox for
that, in which a newer answer replaces an older one that is still waiting. The host writes commands
and reads answers; each direction of its adapter takes a latency. This is enough to say which
control rate a program reaches and which answers never get through.

The loops here are those of programs for arms with MIT-mode drives: commands at a fixed rate,
whatever is answered (:func:`fixed_rate`), and writes and blocking reads in turn
(:func:`blocking_loop`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from cosim.bus.frames import BusEvent, BusFrame
from cosim.bus.settings import BusNodeSettings
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat

#: Identifier with which all drives are asked for their state; it loses against their answers.
REFRESH = 0x7FF


@dataclass(frozen=True, slots=True)
class DriveBus:
    """A bus with drives 1 to `drives`: identifiers i of commands and 0x10 + i of answers, 8 bytes.

    `turn_around`: from the end of a command to the answer's readiness, s; `latency`: of the host's
    adapter, s, in each direction; `seed`: of the bytes, which decide the stuff bits.
    """

    drives: int
    timing: BusTiming
    format: FrameFormat = CLASSIC
    turn_around: float = 30e-6
    latency: float = 0.0
    seed: int = 0


class LoopCount(NamedTuple):
    """What a program reached: cycles and answers per s, load of the bus, answers per command."""

    rate: float
    load: float
    answered: float


@final
class _Simulation:
    """The bus as the host sees it; times in ps."""

    def __init__(self, spec: DriveBus) -> None:
        nodes = [BusNodeSettings("host", queue_length=1024)]
        nodes += [BusNodeSettings(f"drive {i + 1}", queue_length=2) for i in range(spec.drives)]
        kinds = (BusEvent.STARTED, BusEvent.SENT)
        self._bus = SimulatedBus(spec.timing, nodes, record=kinds, seed=spec.seed)
        self._spec, self._random = spec, np.random.default_rng(spec.seed)
        self._pending: dict[int, int] = {}  # request of the answer that waits, by node
        self._asked: dict[int, int] = {}  # drive that a refresh is for, by request
        self._step = round(spec.turn_around * 1e12)
        self._intermission = round(3e12 / spec.timing.bitrate)
        self.latency = round(spec.latency * 1e12)
        self.arrived: deque[int] = deque()  # when the host can read an answer
        self.sent = self.answers = self.busy = 0
        self._begun = 0

    def command(self, at: int, drive: int, *, refresh: bool = False) -> None:
        """Write a command for a drive, or ask it for its state, at the host's time `at`."""
        identifier = REFRESH if refresh else drive
        ready = max(at + self.latency, self._bus.now_ps)
        self._asked[self._bus.request(0, ready, self._frame(identifier))] = drive
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
                    self._answer(self._asked.pop(request), time)
                    continue
                self.answers += 1
                self.arrived.append(time + self.latency)
                if self._pending[node] == request:
                    del self._pending[node]

    def _answer(self, drive: int, heard: int) -> None:
        if (waiting := self._pending.get(drive)) is not None:
            self._bus.abort(drive, waiting)  # the newest wins; what is being sent is finished
        ready = max(heard + self._step, self._bus.now_ps)
        self._pending[drive] = self._bus.request(drive, ready, self._frame(0x10 + drive))

    def _frame(self, identifier: int) -> BusFrame:
        return BusFrame(identifier, self._random.bytes(8), self._spec.format)

    def wait(self, now: int, timeout: int) -> int | None:
        """When the next answer is read by a call at `now`, or None after `timeout` without one."""
        while not self.arrived or self.arrived[0] > now + timeout:
            if self._bus.now_ps >= now + timeout:
                return None
            self.advance(min(now + timeout, self._bus.now_ps + self._step))
        return max(now, self.arrived.popleft())


def fixed_rate(spec: DriveBus, rate: float, seconds: float = 1.0) -> LoopCount:
    """All commands written at once, `rate` times a second, for `seconds`, whatever comes back."""
    simulation = _Simulation(spec)
    period = round(1e12 / rate)
    cycles = int(seconds * rate)
    for k in range(cycles):
        simulation.advance(k * period)
        for drive in range(1, spec.drives + 1):
            simulation.command(k * period, drive)
    simulation.advance(cycles * period)
    answered = simulation.answers / simulation.sent
    return LoopCount(rate, simulation.busy / (cycles * period), answered)


@dataclass(frozen=True, slots=True)
class BlockingLoop:
    """Of each arm in turn: ask all drives, read; command all drives, read; then the controller.

    `ask` and `command`: the first time-outs of the reads, s; `ask` 0 leaves the question out.
    `every_frame`: the time-out holds for every frame, so that a read always ends with an idle
    one; otherwise for the first, and then only what has arrived is read. `controller`: time of the
    controller for all arms, s. `jitter`: the longest delay of a wake-up, s, uniform. `period`: a
    cycle begins this long after the one before, s, or when that is done.
    """

    ask: float = 500e-6
    command: float = 1000e-6
    every_frame: bool = True
    controller: float = 100e-6
    jitter: float = 60e-6
    period: float = 0.0


def blocking_loop(
    specs: Sequence[DriveBus], loop: BlockingLoop, seconds: float = 1.0, seed: int = 0
) -> LoopCount:
    """The rate of a program that runs `loop` over these buses in turn, for `seconds`."""
    arms = [_Simulation(spec) for spec in specs]
    random = np.random.default_rng(seed)
    now, cycles = 0, 0
    while now < seconds * 1e12:
        begun = now
        for arm, spec in zip(arms, specs, strict=True):
            for refresh, timeout in ((True, loop.ask), (False, loop.command)):
                if timeout > 0.0:
                    arm.advance(now)
                    for drive in range(1, spec.drives + 1):
                        arm.command(now, drive, refresh=refresh)
                    now = _read(arm, now, timeout, loop, random)
        now = max(now + round(loop.controller * 1e12), begun + round(loop.period * 1e12))
        cycles += 1
    for arm in arms:
        arm.advance(now)
    sent, answers = sum(arm.sent for arm in arms), sum(arm.answers for arm in arms)
    load = sum(arm.busy for arm in arms) / (len(arms) * now)
    return LoopCount(cycles * 1e12 / now, load, answers / sent)


def _read(
    arm: _Simulation, now: int, timeout: float, loop: BlockingLoop, random: np.random.Generator
) -> int:
    """When a read that begins at `now` returns, ps."""
    left = round(timeout * 1e12)
    while (at := arm.wait(now, left)) is not None:
        if at > now:
            at += int(random.uniform(0.0, loop.jitter) * 1e12)
        now = at
        left = left if loop.every_frame else 0
    return now + left
