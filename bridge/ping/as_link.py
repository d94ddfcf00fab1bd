"""A measured path as a link of a scenario: its trace, a law that resembles it, and ``tc netem``."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bridge.ping.clocks import Floats
from bridge.ping.figures import PathResult, autocorrelation
from bridge.ping.losses import lost_ways, runs
from cosim.base.copies import replace
from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.distributions import Gamma, Lognormal
from cosim.links.laws import Constant, Law
from cosim.links.losses import GilbertElliott, Independent, Loss
from cosim.links.netem import netem

#: Spread below which delays are constant: a part of the mean.
CONSTANT = 0.01
#: Autocorrelation above which a law holds its draws.
CORRELATED = 0.3
_SHARES = (np.arange(200) + 0.5) / 200


@dataclass(frozen=True, slots=True)
class FittedLaw:
    """A law and a loss; `error`: mean distance of its quantiles from those measured, s."""

    law: Law
    loss: Loss | None
    error: float

    def toml(self) -> str:
        """The keys of a link."""
        keys = f"delay = {_table(self.law.facts())}"
        if self.loss is not None:
            keys += f"\nloss = {_table(self.loss.facts())}"
        return keys

    def netem(self, period: float) -> str:
        """Arguments for ``tc netem`` and remarks; `period`: between packets, s."""
        return netem(self.law, self.loss, period=period)


def _table(facts: dict[str, Any]) -> str:
    names = {"bad": "1-h", "good": "1-k"}
    cells = [f"{names.get(k, k)} = {_cell(v)}" for k, v in facts.items() if v is not None]
    return "{ " + ", ".join(cells) + " }"


def _cell(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else f'"{value}"'


def fitted(
    delay: Floats, lag1: float, period: float, sent: NDArray[np.bool_] | None = None
) -> FittedLaw:
    """The nearest of constant, gamma and lognormal laws to `delay` (n,), s, NaN: lost.

    `lag1`: autocorrelation of neighbours, `period` apart, s: draws are held as long as gives it.
    `sent` (n,): what was sent this way, for its losses; None: all.
    """
    T = np.maximum(delay[~np.isnan(delay)], 1e-6)
    lost = _loss(np.isnan(delay if sent is None else delay[sent]))
    if T.size < 10 or np.ptp(T) <= CONSTANT * T.mean():
        return FittedLaw(Constant(float(T.mean())), lost, float(np.abs(T - T.mean()).mean()))
    hold = period / (1 - lag1) if CORRELATED < lag1 < 1 else None
    measured = np.quantile(T, _SHARES)
    candidates: list[Gamma | Lognormal] = [_gamma(T, hold), _lognormal(T, hold)]
    errors = [float(np.abs(_quantiles(law) - measured).mean()) for law in candidates]
    best = int(np.argmin(errors))
    return FittedLaw(candidates[best], lost, errors[best])


def _shift(T: Floats) -> float:
    """A little below the least delay, so that all tails are positive."""
    return max(0.0, float(T.min() - 0.01 * (T.mean() - T.min())))


def _gamma(T: Floats, hold: float | None) -> Gamma:
    tail = T - _shift(T)
    mean, variance = float(tail.mean()), float(tail.var())
    return Gamma(_shift(T), mean**2 / variance, variance / mean, float(T.max()) * 1.001, hold)


def _lognormal(T: Floats, hold: float | None) -> Lognormal:
    logs = np.log(np.maximum(T - _shift(T), 1e-9))
    sigma = min(max(float(logs.std()), 1e-3), 9.0)
    median = float(np.exp(np.median(logs)))
    return Lognormal(_shift(T), median, sigma, float(T.max()) * 1.001, hold)


def _quantiles(law: Gamma | Lognormal) -> Floats:
    """Quantiles of 20000 draws, (200,), s."""
    free = replace(law, hold=None)
    drawn = free.stream(Fraction(1, 100), generator(0, "ping")).take(20_000)
    return np.asarray(np.quantile(drawn, _SHARES))


def _loss(lost: NDArray[np.bool_]) -> Loss | None:
    """The loss whose share and mean number in a row are those of `lost` (n,)."""
    share, (burst, _) = float(lost.mean()), runs(lost)
    if not 0 < share < 1:
        return None
    if burst < 1.5 / (1 - share):
        return Independent(share)
    r = 1 / burst
    return GilbertElliott(min(1.0, r * share / (1 - share)), r)


def laws(result: PathResult) -> dict[str, FittedLaw]:
    """A law for each direction of :func:`traces`, with the losses of that direction alone."""
    period = result.record.period_ns * 1e-9
    ways, found = lost_ways(result.record), {}
    for name, delay in traces(result).items():
        sent = None
        if name == "back" and ways is not None:
            sent = ~ways.there  # the other end answered these
        found[name] = fitted(delay, autocorrelation(delay[~np.isnan(delay)]), period, sent)
    return found


def traces(result: PathResult) -> dict[str, Floats]:
    """The delays of each direction by name, (n,), s; half the round trip if only the sum is known.

    A packet that is lost in one direction has the delay of the packet before it in the other.
    Where it is not known which way was lost, both are; of halves, every second gap is kept, so that
    both together lose what was lost.
    """
    if result.there is None or result.back is None:
        return {"half": _thinned(result.rtt / 2)}
    ways = lost_ways(result.record)
    if ways is None:
        return {"there": _thinned(result.there), "back": _thinned(result.back, 1)}
    known = ~ways.undecided
    return {
        "there": np.where(ways.back & known, _held(result.there), result.there),
        "back": np.where(ways.there & known, _held(result.back), result.back),
    }


def _held(delay: Floats) -> Floats:
    """`delay` (n,) with the delay before it where one is missing, or the first one."""
    rows = np.maximum.accumulate(np.where(np.isnan(delay), -1, np.arange(delay.size)))
    return np.asarray(delay[np.where(rows < 0, int(np.argmax(~np.isnan(delay))), rows)])


def _thinned(delay: Floats, first: int = 0) -> Floats:
    """`delay` (n,) without every second gap, from the gap `first` on."""
    lost = np.isnan(delay)
    gap = np.cumsum(lost & ~np.concatenate([[False], lost[:-1]])) - 1
    return np.where(lost & (gap % 2 != first), _held(delay), delay)


def link_toml(file: str, semantics: str) -> str:
    """The keys of a link that repeats a trace."""
    delay = f'delay = {{ law = "trace", file = "{file}", repeat = true }}'
    return f'{delay}\nsemantics = "{semantics}"'


def semantics_of(kind: str, result: PathResult) -> str:
    """The semantics of a receiver on such a path: UDP and CAN numbered, Zenoh in order."""
    if kind == "zenoh" and not result.loss.share:
        return "fifo"
    return "newest-stamp" if kind == "udp" else "last-arrival"


def netem_line(law: FittedLaw, period: float) -> str | None:
    """The netem line, None if netem has none; `period`: between packets, s."""
    try:
        return law.netem(period)
    except ScenarioError:
        return None
