"""Figures of a ping: delays each way with their uncertainty, losses, outages, parts of the time."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from bridge.ping.clocks import ClockEstimate, Floats, estimate_clock, same_clock
from bridge.ping.exchanges import NONE, Exchanges
from bridge.ping.intervals import interval
from bridge.ping.losses import LossFigures, loss_figures
from bridge.ping.measure import clock_number
from bridge.realtime.host_clock import host_clock
from cosim.base.clock import realtime_offset_ns
from cosim.base.errors import RunError

QUANTILES = (0.5, 0.95, 0.99, 0.999)


@dataclass(frozen=True, slots=True)
class WayFigures:
    """Figures of delays (n,), s. `quantiles`: of 50, 95, 99 and 99.9 %; `ranges`: intervals that
    contain each with 95 % confidence, an end infinite where too few independent delays are beyond
    it; `independent`: how many independent delays would tell as much about each.

    `jitter`: mean difference of consecutive delays, s; `lag1`: their autocorrelation.
    """

    n: int
    minimum: float
    mean: float
    sd: float
    maximum: float
    quantiles: tuple[float, ...]
    ranges: tuple[tuple[float, float], ...]
    independent: tuple[float, ...]
    jitter: float
    lag1: float


def way_figures(delay: Floats, below: float = 0.0, above: float = 0.0) -> WayFigures:
    """Figures of `delay` (n,), s, NaN where nothing arrived; at least one arrived.

    The truth may be less than `delay` by `below` and more by `above`, s, the same for all.
    """
    there = delay[~np.isnan(delay)]
    ordered, steps = np.sort(there), np.abs(np.diff(there))
    found = [interval(there, ordered, q) for q in QUANTILES]
    return WayFigures(
        there.size, float(ordered[0]), float(there.mean()), float(there.std()), float(ordered[-1]),
        tuple(float(x) for x in np.quantile(there, QUANTILES)),
        tuple((low - below, high + above) for low, high, _ in found),
        tuple(n for _, _, n in found),
        float(steps.mean()) if steps.size else 0.0, autocorrelation(there),
    )  # fmt: skip


def autocorrelation(x: Floats) -> float:
    """Correlation of neighbours in `x` (n,), dimensionless, -1 to 1; 0 if nothing varies."""
    if x.size < 3:
        return 0.0
    rest = x - x.mean()
    power = float(rest @ rest)
    return float(rest[:-1] @ rest[1:]) / power if power > 0 else 0.0


@dataclass(frozen=True, slots=True)
class PathResult:
    """The measured delays of a path. Arrays (n,) are in the order of the questions, s, NaN: lost.

    `sent`: times of the questions from the first; `rtt`: round trip without the other end's
    turn-round; `there`, `back`: as an application has them, None where only the sum is known;
    `below`, `above` (n,): by how much `there` may be less and more (and `back` more and less).
    `dates`: that of the other host less ours, s, None: not said; `kept`: errors of our and of the
    other date by their time servers, s, infinite without one. `parts`: medians of where a round
    trip goes, s, by name; `late`: of questions, s.
    """

    record: Exchanges
    sent: Floats
    rtt: Floats
    there: Floats | None
    back: Floats | None
    below: Floats | None
    above: Floats | None
    clock: ClockEstimate | None
    same_host: bool
    dates: float | None
    kept: tuple[float, float]
    loss: LossFigures
    parts: dict[str, float]
    late: Floats

    @property
    def uncertainty(self) -> float:
        """Largest error of `there` and of `back`, s; the same for all packets of one piece."""
        if self.below is None or self.above is None:
            return inf
        return float(max(np.nanmax(self.below), np.nanmax(self.above)))

    @property
    def ways(self) -> dict[str, Floats]:
        """The measured delays by name, (n,), s."""
        found = {"round trip": self.rtt}
        if self.there is not None and self.back is not None:
            found |= {"there": self.there, "back": self.back}
        return found

    def figures(self) -> dict[str, WayFigures]:
        """Figures of each way by name. Intervals contain what the clocks leave open."""
        found = {"round trip": way_figures(self.rtt)}
        if self.there is not None and self.back is not None:
            assert self.below is not None and self.above is not None
            below, above = float(np.nanmax(self.below)), float(np.nanmax(self.above))
            found["there"] = way_figures(self.there, below, above)
            found["back"] = way_figures(self.back, above, below)
        return found


def _seconds(record: Exchanges, name: str, origin: int = 0) -> Floats:
    """A stamp as s from `origin` (ns), NaN where it is unknown."""
    ns = record.stamp(name)
    known = ns != NONE
    found: Floats = np.where(known, (np.where(known, ns, origin) - origin) * 1e-9, np.nan)
    return found


def evaluate(record: Exchanges) -> PathResult:
    """All figures of a record. Raises RunError if nothing came back."""
    if not record.received or np.all(record.stamp("t4") == NONE):
        raise RunError(
            f"{record.what}: none of {record.sent} questions was answered; expected a responder: "
            "start `cosim pong` at the other end, and check the address and firewalls"
        )
    origin = int(record.stamp("t1")[0])
    t1, t4 = _seconds(record, "t1", origin), _seconds(record, "t4", origin)
    wake_here = np.nan_to_num(_seconds(record, "wake_here"))
    late = t1 - _seconds(record, "due", origin)
    parts = {
        "send call": float(np.median(_seconds(record, "call"))),
        "own wake-up": float(np.nanmedian(np.where(np.isnan(t4), np.nan, wake_here))),
    }
    loss = loss_figures(record, t1, t4)
    if np.all(record.stamp("t2") == NONE):
        rtt = t4 + wake_here - t1
        none = None
        return PathResult(
            record,
            t1,
            rtt,
            none,
            none,
            none,
            none,
            none,
            False,
            none,
            (inf, inf),
            loss,
            parts,
            late,
        )
    return _both_ways(record, t1, t4, wake_here, loss, parts, late)


def _both_ways(
    record: Exchanges, t1: Floats, t4: Floats, wake_here: Floats,
    loss: LossFigures, parts: dict[str, float], late: Floats,
) -> PathResult:  # fmt: skip
    first = int(record.stamp("t2")[record.stamp("t2") != NONE][0])
    t2, t3 = _seconds(record, "t2", first), _seconds(record, "t3", first)
    wake_there = _seconds(record, "wake_there")
    F, B, there = t2 - t1, t4 - t3, ~np.isnan(t4)
    shift = (int(record.stamp("t1")[0]) - first) * 1e-9  # of the two origins, s
    ours, other = host_clock(), record.other
    assert other is not None
    theirs = other.error * 1e-9 if other.error >= 0 else inf
    kept = (ours.error if ours.kept else inf, theirs)
    clock, same, dates = _clock(record, kept, t1[there], F[there], t4[there], B[there], shift)
    low, middle, high = clock.offsets(t1)
    turn = t3 - t2 - wake_there
    parts |= {
        "other wake-up": float(np.nanmedian(wake_there)),
        "turn-round": float(np.nanmedian(turn)),
        "network, both ways": float(np.nanmedian(F + B)),
    }
    forward, backward = F + wake_there - middle, B + wake_here + middle
    return PathResult(
        record, t1, forward + backward, forward, backward, high - middle, middle - low,
        clock, same, dates, kept, loss, parts, late,
    )  # fmt: skip


def _clock(
    record: Exchanges,
    kept: tuple[float, float],
    t1: Floats,
    F: Floats,
    t4: Floats,
    B: Floats,
    shift: float,
) -> tuple[ClockEstimate, bool, float | None]:
    """The other clock (zero of both at their first stamps), whether it is ours, and the difference
    of the dates of the hosts (theirs less ours, s; None: not said).
    """
    other = record.other
    assert other is not None
    if other.host == clock_number(host_clock()):
        zero = same_clock(float(t1[0]), float(t1[-1]))
        piece = zero.pieces[0]
        shifted = type(piece)(
            piece.start, piece.end, piece.centre, piece.drift,
            piece.upper + shift, piece.lower + shift, shift, 0.0,
        )  # fmt: skip
        return ClockEstimate((shifted,)), True, 0.0
    if not other.date:
        return estimate_clock(t1, F, t4, B), False, None
    apart = (realtime_offset_ns() - other.date) * 1e-9 + shift  # θ of clocks with equal dates
    error = sum(kept)
    known = (apart - error, apart + error) if error < inf else None
    clock = estimate_clock(t1, F, t4, B, known)
    _, theta, _ = clock.offsets(t1[-1:])
    return clock, False, float(theta[0] - apart)
