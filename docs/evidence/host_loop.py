"""A program that commands drives over a simulated bus: what its blocking reads make of it.

This is enough to say which control rate a program reaches, which answers never get through, and how
old states and references are when they act.

The loops here are those of programs for arms with MIT-mode drives: commands at a fixed rate,
whatever is answered (:func:`fixed_rate`), writes and blocking reads in turn
(:func:`blocking_loop`), and two arms that follow each other, with a thread each
(:func:`bilateral_loop`).
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from docs.evidence.drive_bus import DriveBus, DrivenBus


class LoopCount(NamedTuple):
    """Counts of a program: cycles and answers per s, load of the bus, answers per command."""

    rate: float
    load: float
    answered: float


def fixed_rate(spec: DriveBus, rate: float, seconds: float = 1.0) -> LoopCount:
    """All commands written at once, `rate` times a second, for `seconds`, whatever comes back."""
    simulation = DrivenBus(spec)
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
    """A loop over the arms in turn: ask all drives, read; command all drives, read; then the
    controller.

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
    arms = [DrivenBus(spec) for spec in specs]
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
    arm: DrivenBus, now: int, timeout: float, loop: BlockingLoop, random: np.random.Generator
) -> int:
    """The time at which a read that begins at `now` returns, ps."""
    left = round(timeout * 1e12)
    while (answer := arm.wait(now, left)) is not None:
        if answer.at > now:
            now = answer.at + int(random.uniform(0.0, loop.jitter) * 1e12)
        left = left if loop.every_frame else 0
    return now + left


@dataclass(frozen=True, slots=True)
class BilateralLoop:
    """Three threads with one `period`, s: one of each arm, and one that exchanges their states.

    The thread of an arm writes a command to each drive from the state and the reference in memory,
    waits for `pause`, s, and reads what has arrived, or for `first`, s, if nothing has. The third
    copies the last state of each arm to the other's reference. A wake-up is late by up to `jitter`,
    s, uniform; `stalls` times a second it is late by one of `stall`, s, uniform. A thread that is
    late runs the cycles that it missed one after the other.
    """

    period: float = 2e-3
    pause: float = 200e-6
    first: float = 220e-6
    jitter: float = 60e-6
    stalls: float = 0.0
    stall: tuple[float, float] = (5e-3, 30e-3)


class CommandTimes(NamedTuple):
    """Commands that one drive heard: when, and when the states in them were taken; s, (n,) each.

    `own`: the drive's own state, `other`: that of the same drive of the other arm.
    """

    heard: NDArray[np.float64]
    own: NDArray[np.float64]
    other: NDArray[np.float64]


def bilateral_loop(
    specs: tuple[DriveBus, DriveBus],
    loop: BilateralLoop,
    drive: int,
    seconds: float = 1.0,
    seed: int = 0,
) -> tuple[CommandTimes, CommandTimes]:
    """Commands that `drive` of each arm hears in `seconds`, s, if two arms follow each other."""
    run = _Bilateral(specs, loop, drive, seed)
    run.until(round(seconds * 1e12))
    return run.commands(0), run.commands(1)


@final
class _Bilateral:
    """The threads of two arms; times in ps."""

    def __init__(
        self, specs: tuple[DriveBus, DriveBus], loop: BilateralLoop, drive: int, seed: int
    ) -> None:
        self._arms = [DrivenBus(spec) for spec in specs]
        self._drives = [spec.drives for spec in specs]
        self._loop, self._drive = loop, drive
        self._random = np.random.default_rng(seed)
        self._state: list[int | None] = [None, None]  # when the last state read was taken
        self._reference: list[int | None] = [None, None]
        self._period = round(loop.period * 1e12)
        # what happens next: when, the thread, the time it was due, and whether it reads
        self._next: list[tuple[int, int, int, bool]] = []
        for thread in range(3):
            due = int(self._random.uniform(0.0, self._period))
            heapq.heappush(self._next, (due, thread, due, False))

    def until(self, end: int) -> None:
        """Run all threads to `end`."""
        while self._next[0][0] < end:
            now, thread, due, reads = heapq.heappop(self._next)
            if thread == 2:
                self._reference = [self._state[1], self._state[0]]
                self._wake(thread, due, now)
            elif reads:
                self._wake(thread, due, self._read(thread, now))
            else:
                self._write(thread, now)
                read = now + round(self._loop.pause * 1e12) + self._late()
                heapq.heappush(self._next, (read, thread, due, True))

    def _wake(self, thread: int, due: int, now: int) -> None:
        """The next cycle of a thread that is done at `now`."""
        due += self._period
        at = due + self._late()
        if self._random.random() < self._loop.stalls * self._loop.period:
            at += int(self._random.uniform(*self._loop.stall) * 1e12)
        heapq.heappush(self._next, (max(at, now), thread, due, False))

    def _late(self) -> int:
        return int(self._random.uniform(0.0, self._loop.jitter) * 1e12)

    def _write(self, arm: int, now: int) -> None:
        bus, tag = self._arms[arm], (self._state[arm], self._reference[arm])
        bus.advance(now)
        for drive in range(1, self._drives[arm] + 1):
            bus.command(now, drive, tag=tag)

    def _read(self, arm: int, now: int) -> int:
        """The time at which the read that begins at `now` returns."""
        left = round(self._loop.first * 1e12)
        while (answer := self._arms[arm].wait(now, left)) is not None:
            now, left = max(now, answer.at), 0
            if answer.drive == self._drive:
                self._state[arm] = answer.sampled
        return now + left

    def commands(self, arm: int) -> CommandTimes:
        """The times of the commands that had both states."""
        rows = [
            (command.at, *command.tag)
            for command in self._arms[arm].heard
            if command.drive == self._drive and isinstance(command.tag, tuple)
        ]
        known = [row for row in rows if None not in row]
        return CommandTimes(*(1e-12 * np.array(known, dtype=np.float64).reshape(-1, 3).T))
