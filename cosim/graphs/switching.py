"""Switching topologies: a constant graph, random graphs at fixed intervals, or a schedule.

They are values like delay laws: frozen, with declared facts, and streamed in chunks whose sizes
change nothing. A graph is in effect from its time on: a read at t uses the last graph whose time is
not after t. A graph that is in effect only between two reads has no effect.

Source: the paper, Sec. V (graphs, union, dwell time) and Sec. VII-B (random switching).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.links.laws import Delays, FloatArray, IntArray, decimal_fraction, hold_delays
from cosim.links.semantics import Cycle

if TYPE_CHECKING:
    from numpy.random import Generator


class Choices(Protocol):
    """The graphs at the looks of one receiver, in order."""

    def take(self, n: int) -> IntArray:
        """The index of the graph at each of the next `n` looks, (n,)."""


class Switching(Protocol):
    """The graph in effect at each time: declared facts and a way to draw."""

    def check(self, graphs: int) -> None:
        """Refuse a number of graphs it does not switch between. Raises ScenarioError."""

    def recurrent(self, graphs: int) -> tuple[int, ...]:
        """The graphs that are there again and again for ever, by index."""

    def shares(self, graphs: int, period: Fraction) -> FloatArray:
        """The share of looks, a `period` (s) apart, at which each graph is there in the long run.

        Shape (graphs,); the sum is 1. Expected values where graphs are drawn.
        """

    def stream(self, graphs: int, period: Fraction, rng: Generator) -> Choices:
        """The graphs at t = 0, period, 2·period, … (s), drawn from `rng`."""

    def facts(self) -> dict[str, Any]:
        """The metadata of a run, SI."""


@dataclass(frozen=True, slots=True)
class Static:
    """One graph, always."""

    def check(self, graphs: int) -> None:
        """Refuse more graphs than one. Raises ScenarioError."""
        if graphs != 1:
            raise ScenarioError(
                f"{graphs} graphs without a switching rule; expected one graph, a"
                " dwell time or a schedule"
            )

    def recurrent(self, graphs: int) -> tuple[int, ...]:
        """The graph."""
        return (0,)

    def shares(self, graphs: int, period: Fraction) -> FloatArray:
        """Return the fraction of reads that see the graph: 1, of shape (1,)."""
        return np.ones(1)

    def stream(self, graphs: int, period: Fraction, rng: Generator) -> Choices:
        """Nothing is drawn."""
        return _Always()

    def facts(self) -> dict[str, Any]:
        """Its name."""
        return {"switching": "static"}


class _Always:
    def take(self, n: int) -> IntArray:
        return np.zeros(n, np.int64)


@dataclass(frozen=True, slots=True)
class Random:
    """A graph drawn every `dwell` (s), all equally likely, the last one included (Sec. VII-B).

    Every graph comes again and again, but within no bounded time: that the uniformly bounded
    intervals of Theorems 3 and 4 exist is very likely in a run, not certain.
    """

    dwell: float

    def __post_init__(self) -> None:
        """Check the time. Raises ScenarioError."""
        if not (isfinite(self.dwell) and self.dwell > 0):
            raise ScenarioError(f"dwell = {self.dwell:g} s; expected a time greater than 0")

    def check(self, graphs: int) -> None:
        """Any number will do."""

    def recurrent(self, graphs: int) -> tuple[int, ...]:
        """All."""
        return tuple(range(graphs))

    def shares(self, graphs: int, period: Fraction) -> FloatArray:
        """Return the fractions (graphs,): all graphs are equally likely."""
        return np.full(graphs, 1.0 / graphs)

    def stream(self, graphs: int, period: Fraction, rng: Generator) -> Choices:
        """One draw a dwell time, whether a look falls into it or not."""

        def draw(n: int) -> FloatArray:
            return np.floor(graphs * rng.random(n))

        return _Drawn(hold_delays(draw, self.dwell, period, "dwell"))

    def facts(self) -> dict[str, Any]:
        """Its name and dwell (s)."""
        return {"switching": "random", "dwell": self.dwell}


class _Drawn:
    def __init__(self, drawn: Delays) -> None:
        self._drawn = drawn

    def take(self, n: int) -> IntArray:
        return self._drawn.take(n).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Schedule:
    """Graph indices[i] from times[i] (s) on; from the start again every `repeat` (s), or not.

    `times` begin with 0 and increase; without `repeat` the last graph stays.
    """

    times: tuple[float, ...]
    indices: tuple[int, ...]
    repeat: float | None = None

    def __post_init__(self) -> None:
        """Check the schedule. Raises ScenarioError."""
        if not self.times or len(self.times) != len(self.indices):
            raise ScenarioError(
                f"schedule of {len(self.times)} times and {len(self.indices)} graphs; expected"
                " equally many, at least one"
            )
        if self.times[0] != 0:
            raise ScenarioError(f"schedule begins at {self.times[0]:g} s; expected 0")
        for before, time in zip(self.times, self.times[1:], strict=False):
            if not (isfinite(time) and time > before):
                raise ScenarioError(
                    f"schedule: {time:g} s after {before:g} s; expected increasing times"
                )
        if self.repeat is not None and not (isfinite(self.repeat) and self.repeat > self.times[-1]):
            raise ScenarioError(
                f"repeat = {self.repeat:g} s; expected more than the last time of the schedule,"
                f" {self.times[-1]:g} s"
            )

    def check(self, graphs: int) -> None:
        """Refuse an index that no graph has. Raises ScenarioError."""
        for index in self.indices:
            if not 0 <= index < graphs:
                raise ScenarioError(f"schedule: graph index {index}; expected 0 to {graphs - 1}")

    def recurrent(self, graphs: int) -> tuple[int, ...]:
        """The graphs that recur: those of the schedule if it repeats, else the last."""
        return self.indices[-1:] if self.repeat is None else tuple(sorted(set(self.indices)))

    def shares(self, graphs: int, period: Fraction) -> FloatArray:
        """The parts of a cycle in which each graph is there, (graphs,), exact.

        Looks a `period` apart meet all parts of the cycle equally often (see :class:`Cycle`).
        """
        found = np.zeros(graphs)
        if self.repeat is None:
            found[self.indices[-1]] = 1.0
            return found
        cycle = Cycle(period, self.repeat)
        whole = cycle.ratio.denominator
        first = [cycle.parts(decimal_fraction(t)) for t in self.times]
        for index, start, stop in zip(self.indices, first, [*first[1:], whole], strict=True):
            found[index] += (stop - start) / whole
        return found

    def stream(self, graphs: int, period: Fraction, rng: Generator) -> Choices:
        """Nothing is drawn."""
        return _Scheduled(self, period)

    def facts(self) -> dict[str, Any]:
        """Its name, times, repeat (s) and indices."""
        return {
            "switching": "schedule",
            "times": list(self.times),
            "indices": list(self.indices),
            "repeat": self.repeat,
        }


class _Scheduled:
    def __init__(self, schedule: Schedule, period: Fraction) -> None:
        self._indices, self._look = np.array(schedule.indices, dtype=np.int64), 0
        self._cycle = None if schedule.repeat is None else Cycle(period, schedule.repeat)
        times = [decimal_fraction(t) for t in schedule.times]
        self._from = np.array(  # (times,), the first look, or part of the cycle, of each
            [ceil(t / period) if self._cycle is None else self._cycle.parts(t) for t in times]
        )

    def take(self, n: int) -> IntArray:
        if self._cycle is None:
            looks = np.arange(self._look, self._look + n, dtype=np.int64)
        else:
            looks = self._cycle.phases(self._look, n)
        self._look += n
        chosen: IntArray = self._indices[np.searchsorted(self._from, looks, side="right") - 1]
        return chosen
