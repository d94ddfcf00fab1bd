"""Delay laws: the delay of each sample that is sent, or read, at t = 0, period, 2·period and so on.

A law is a frozen value. It declares facts (`minimum`, `maximum`, `loses`) that hold for every delay
it generates, and the long-term `mean`. :meth:`Law.stream` starts the delays of one link. They are
generated in chunks whose sizes do not change the values: the same generator state gives the same
delays. A lost packet has a delay that is not finite.

This module has the protocol, the two simplest laws, and sums. `losses` combines any law with a loss
model. To add a law, add a struct with these members, whose fields are its keys, and its name to
`spec`.

Source: the paper, Sec. VII, for the uniform law that is redrawn at fixed intervals; the interface
is our own construction.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError
from cosim.links.keys import Keyed, Seconds

if TYPE_CHECKING:
    from numpy.random import Generator

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Delays(Protocol):
    """The delays of one link, in order."""

    def take(self, n: int) -> FloatArray:
        """The next `n` delays, (n,), s; not finite where the packet is lost."""


class Law(Protocol):
    """A delay law: declared facts and a way to draw."""

    @property
    def minimum(self) -> float:
        """No delay is shorter, s."""

    @property
    def maximum(self) -> float:
        """No delay of a packet that arrives is longer, s."""

    @property
    def mean(self) -> float:
        """The long-term mean of the delays that arrive, s."""

    @property
    def loses_packets(self) -> bool:
        """True if a packet can be lost."""

    def limit(self, period: Fraction) -> int | None:
        """Number of delays available at this sampling period (s); None: unlimited."""

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The delays at t = 0, period, 2·period, … (s), drawn from `rng`."""

    def facts(self) -> dict[str, Any]:
        """The metadata of a run: the law's name and its values, SI."""


@lru_cache(maxsize=64)
def decimal_fraction(seconds: float) -> Fraction:
    """A time, s, as the decimal number that was written, not the nearest binary: 0.03 is 3/100."""
    return Fraction(repr(float(seconds)))


class Formula(Keyed, frozen=True):
    """A law that is a formula: it loses nothing, gives any number of delays, and is its fields."""

    @property
    def loses_packets(self) -> bool:
        """Never."""
        return False

    def limit(self, period: Fraction) -> int | None:
        """Unlimited."""
        return None


class LawSource(Keyed, frozen=True):
    """Keys that name a law, or a file with one."""

    def law(self, folder: Path) -> Law:
        """The law; files relative to `folder`. Raises ScenarioError."""
        raise NotImplementedError


class Constant(Formula, frozen=True, tag="constant"):
    """T(t) = delay (s)."""

    delay: Seconds

    def __post_init__(self) -> None:
        """Check the delay. Raises ScenarioError."""
        check_delay("delay", self.delay)

    @property
    def minimum(self) -> float:
        """The delay, s."""
        return self.delay

    @property
    def maximum(self) -> float:
        """The delay, s."""
        return self.delay

    @property
    def mean(self) -> float:
        """The delay, s."""
        return self.delay

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """The same delay for ever; nothing is drawn."""
        return _Same(self.delay)


class Uniform(Formula, frozen=True, tag="uniform"):
    """T(t) = low + (high - low)·u_i, u_i ~ U[0, 1), i = floor(t / hold): constant in between.

    The paper's delay (Sec. VII) is low = 0.3 s, high = 1.2 s, hold = 0.03 s. `hold = None` draws
    anew for every sample. i is computed in integers from the decimal numbers as written, so that
    the redraw at t = 0.03 s happens there and not one sample later.
    """

    low: Seconds
    high: Seconds
    hold: Seconds | None = None

    def __post_init__(self) -> None:
        """Check the parameters of the distribution. Raises ScenarioError."""
        check_delay("low", self.low)
        check_delay("high", self.high)
        if self.high < self.low:
            raise ScenarioError(f"high = {self.high:g} s is less than low = {self.low:g} s")
        check_hold(self.hold)

    @property
    def minimum(self) -> float:
        """Lower bound, s."""
        return self.low

    @property
    def maximum(self) -> float:
        """Upper bound, s."""
        return self.high

    @property
    def mean(self) -> float:
        """(low + high)/2, s."""
        return 0.5 * (self.low + self.high)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """One draw a hold interval, whether a sample falls into it or not."""

        def draw(n: int) -> FloatArray:
            return np.minimum(self.low + (self.high - self.low) * rng.random(n), self.high)

        return hold_delays(draw, self.hold, period)


class Sum(Struct, frozen=True):
    """T(t) = Σ_j T_j(t) of independent laws, none of which loses packets."""

    parts: tuple[Law, ...]

    def __post_init__(self) -> None:
        """Refuse nothing, and what loses packets. Raises ScenarioError."""
        if not self.parts:
            raise ScenarioError("of names no delay law; expected one or more")
        if any(law.loses_packets for law in self.parts):
            raise ScenarioError(
                "a law of the sum loses packets; expected laws without losses, and the key loss"
            )

    @property
    def minimum(self) -> float:
        """The sum of the minima, s."""
        return sum(law.minimum for law in self.parts)

    @property
    def maximum(self) -> float:
        """The sum of the maxima, s."""
        return sum(law.maximum for law in self.parts)

    @property
    def mean(self) -> float:
        """The sum of the means, s."""
        return sum(law.mean for law in self.parts)

    @property
    def loses_packets(self) -> bool:
        """Never."""
        return False

    def limit(self, period: Fraction) -> int | None:
        """The least limit of the parts."""
        limits = [x for x in (law.limit(period) for law in self.parts) if x is not None]
        return min(limits, default=None)

    def stream(self, period: Fraction, rng: Generator) -> Delays:
        """Each part draws from a generator of its own."""
        own = rng.spawn(len(self.parts))
        return _Added([p.stream(period, r) for p, r in zip(self.parts, own, strict=True)])

    def facts(self) -> dict[str, Any]:
        """The facts of the parts."""
        return {"law": "sum", "of": [law.facts() for law in self.parts]}


class _Added:
    def __init__(self, streams: list[Delays]) -> None:
        self._streams = streams

    def take(self, n: int) -> FloatArray:
        total = np.zeros(n)
        for stream in self._streams:
            total += stream.take(n)
        return total


def hold_delays(
    draw: Callable[[int], FloatArray], hold: float | None, period: Fraction, name: str = "hold"
) -> Delays:
    """Delays at t = 0, period, … (s), each the draw number floor(t / hold); None: one a sample.

    `draw(n)`: the next n draws, (n,), s, in an order that n does not change; `name`: what `hold`
    is called in messages. Raises ScenarioError for more than 10000 draws a sample.
    """
    return _Held(draw, draws_per_sample(hold, period, name))


def draws_per_sample(hold: float | None, period: Fraction, name: str = "hold") -> Fraction:
    """Period (s)/hold, 1 without a hold; see :func:`hold_delays`. Raises ScenarioError."""
    if hold is None:
        return Fraction(1)
    ratio = (period / decimal_fraction(hold)).limit_denominator(10**9)
    if ratio > 10**4:
        raise ScenarioError(
            f"{name} = {hold:g} s; expected at least 1/10000 of the sampling period"
            f" {float(period):g} s"
        )
    return ratio


class _Same:
    def __init__(self, delay: float) -> None:
        self._delay = delay

    def take(self, n: int) -> FloatArray:
        return np.full(n, self._delay)


class _Held:
    """Carry: which sample is next, and the draw that is still held."""

    def __init__(self, draw: Callable[[int], FloatArray], ratio: Fraction) -> None:
        self._fresh, self._ratio = draw, ratio
        self._sample = 0  # the next sample
        self._draw = -1  # index of the last draw made
        self._value = np.zeros(1)  # (1,), the last draw made, s

    def take(self, n: int) -> FloatArray:
        if n == 0:
            return np.empty(0)
        p, q = self._ratio.numerator, self._ratio.denominator
        whole, rest = divmod(self._sample * p, q)  # Python integers: no overflow in long runs
        first = self._draw - whole  # what `_value` holds, relative to `whole`
        which = _which(p, q, rest, n, first)
        drawn = np.concatenate((self._value, self._fresh(int(which[-1]))))
        self._sample, self._value = self._sample + n, drawn[-1:]
        self._draw = whole + first + int(which[-1])
        taken: FloatArray = drawn[which]
        return taken


@lru_cache(maxsize=16)
def _which(p: int, q: int, rest: int, n: int, first: int) -> IntArray:
    """(n,): floor((rest + p i)/q) - first; the same for all links with these periods."""
    which: IntArray = (rest + p * np.arange(n, dtype=np.int64)) // q - first
    which.flags.writeable = False
    return which


def check_delay(name: str, value: float) -> None:
    """Check a delay, s. Raises ScenarioError."""
    if not (isfinite(value) and value >= 0):
        raise ScenarioError(f"{name} = {value:g} s; expected a delay of 0 or more")


def check_hold(hold: float | None) -> None:
    """Check a time between two draws, s. Raises ScenarioError."""
    if hold is not None and not (isfinite(hold) and hold > 0):
        raise ScenarioError(f"hold = {hold:g} s; expected a time greater than 0 between two draws")
