"""Metrics: one number of the summary each, declared in the scenario, computed from a run.

A metric names recorded signals and knows nothing else: no robot, no role. With x(t) the stacked
entries of its signals, recorded at t_0 … t_n:

=============  ===================================================================
error          E(t) = max over signals of ‖x(t) - target(t)‖; E(t_n), RMSE, max, settle time
norm           ‖x‖₂ = sqrt(∫ |x|² dt)
integral_abs   ∫ |x| dt
rms            sqrt(∫ |x|² dt / (t_n - t_0))
tail_mean      mean of |x| over the rows of the last `window` seconds
vibration      half of max - min in the last `window` seconds, of the entry where it is greatest;
               its frequency from the times at which it crosses the middle between the two
peak           max over time and entries of |x_i|
final          x(t_n); |x(t_n)| for more than one entry
rms_free       and ``rms_contact``, ``energy``: see :mod:`cosim.measure.contact_metrics`
=============  ===================================================================

|x| is the Euclidean norm of x(t). Integrals are trapezoids over the recorded rows, so what is
recorded coarsely is integrated coarsely. A number that cannot be had (nothing recorded, a value
that is not finite) is NaN with a sentence; a metric that makes no sense raises ScenarioError.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import pairwise
from math import inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Literal, TypeAlias, cast, final, get_args

import numpy as np

from cosim.base.convert import Struct
from cosim.base.errors import ScenarioError
from cosim.base.names import listed
from cosim.base.units import time_text
from cosim.measure.metric_result import MetricResult as MetricResult
from cosim.measure.metric_result import length, times, with_unit
from cosim.record.piecewise import NotFinite, PairwiseSum, Stacked, Trapezoids
from cosim.record.run import Run
from cosim.record.signals import Array, Signals, Stack

if TYPE_CHECKING:
    from cosim.measure.contact_metrics import Phase, PhaseError, PortEnergy

Kind = Literal["norm", "integral_abs", "rms", "tail_mean", "vibration", "peak", "final"]
Distance = Literal["max", "euclidean"]

_PHASES = ("rms_free", "rms_contact")
_KINDS = ("error", *get_args(Kind), *_PHASES, "energy")
#: Keys that a kind needs, and that it takes besides.
_NEEDS = {
    "error": ("target",),
    **dict.fromkeys(("tail_mean", "vibration"), ("window",)),
    **dict.fromkeys(_PHASES, ("target", "contact")),
}
_TAKES = {**_NEEDS, "error": ("target", "within")}


class Error(Struct, frozen=True):
    """The distance of signals from a target: E(t) = max over `of` of ‖x(t) - target(t)‖.

    `target`: a number per entry, a signal, or a signal for each of `of`. `norm`: the largest entry
    ("max", by which settle times of joints are told here) or the Euclidean norm. The settle time is
    the last exit from the band E < `within`: from the row after it on, the error stays inside. RMSE
    is the root of the mean of E² over time.
    """

    name: str
    of: tuple[str, ...]
    target: tuple[float, ...] | tuple[str, ...] | str
    within: float | None = None
    norm: Distance = "max"
    label: str = ""

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals it reads."""
        return (*self.of, *self._targets)

    @property
    def _targets(self) -> tuple[str, ...]:
        """The signals among the targets."""
        given = (self.target,) if isinstance(self.target, str) else self.target
        return tuple(one for one in given if isinstance(one, str))

    def evaluate(self, signals: Signals) -> MetricResult:
        """E(t_n), with RMSE, maximum and settle time as further facts and in the parts."""
        place, label = f"metrics.{self.name}", self.label or self.name
        whole = Stacked(signals, self.signals, place)
        ends = np.cumsum([len(signals.entries(name)) for name in self.signals])
        self._target([np.empty((0, n)) for n in np.diff(ends, prepend=0)], place)
        distance = _largest if self.norm == "max" else length
        square, settled, peak, at = Trapezoids(whole.rows), _Settling(self.within or inf), -inf, nan
        E, t, unit = np.empty(0), np.empty(0), whole.unit
        try:
            for rows in whole:
                each = [rows.x[:, i:j] for i, j in pairwise((0, *ends))]  # (n, m), targets last
                pairs = zip(each[: len(self.of)], self._target(each, place), strict=True)
                E, t = reduce(np.maximum, [distance(x - target) for x, target in pairs]), rows.t
                square.add(E**2, t)
                settled.add(E, t)
                worst = int(np.argmax(E))
                if E[worst] > peak:
                    peak, at = float(E[worst]), float(t[worst])
        except NotFinite as why:
            return MetricResult(self.name, label, nan, unit, str(why))
        duration = whole.last - whole.first
        rmse = sqrt(square.value / duration) if duration > 0 else float(abs(E[-1]))
        parts = {"final": float(E[-1]), "rmse": rmse, "max": peak, "max_at_s": at}
        more = [
            (f"{label}, RMS", f"{with_unit(rmse, unit)} over {time_text(duration)}"),
            (f"{label}, peak", f"{with_unit(peak, unit)} at {time_text(at)}"),
        ]
        if self.within is not None:
            parts["settle_s"] = settled.time
            words = _settled(settled.time - whole.first, label, E[-1], self.within, unit)
            more.append(("settled", words))
        words = f"at the end ({time_text(whole.last)})"
        return MetricResult(self.name, label, parts["final"], unit, words, parts, tuple(more))

    def _target(self, each: Sequence[Array], place: str) -> list[Array]:
        """The target of each signal, (n, m), or (1, m) if it is fixed; m is checked."""
        count = len(self.of)
        if isinstance(self.target, str):
            targets, found = [each[-1]] * count, [f"{self.target} of size"] * count
        elif names := self._targets:
            if len(names) != count:
                raise ScenarioError(
                    f"found {len(names)} targets, expected one for each of {count} signals", place
                )
            targets, found = list(each[count:]), [f"{name} of size" for name in names]
        else:
            fixed = np.array([self.target], dtype=np.float64)
            targets, found = [fixed] * count, ["a list of length"] * count
        for name, x, target, words in zip(self.of, each, targets, found, strict=False):
            if x.shape[1] != target.shape[1]:
                raise ScenarioError(
                    f"{name} has size {x.shape[1]}, but its target is {words} {target.shape[1]}",
                    place,
                )
        return targets


class Measure(Struct, frozen=True):
    """A number of the stacked signals `of` by themselves; `kind` as in the table above.

    `window`: s, of ``tail_mean`` and ``vibration``.
    """

    name: str
    kind: Kind
    of: tuple[str, ...]
    window: float = 0.0
    label: str = ""

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals it reads."""
        return self.of

    def evaluate(self, signals: Signals) -> MetricResult:
        """The number, over all that was recorded."""
        s = Stacked(signals, self.of, f"metrics.{self.name}")
        unit = times(s.unit, {"norm": "√s", "integral_abs": "s"}.get(self.kind, ""))
        try:
            value, words, parts = _MEASURES[self.kind](s, self.window)
        except NotFinite as why:
            return MetricResult(self.name, self.label or self.name, nan, unit, str(why))
        if self.kind in _WORDS:
            words = f"({_WORDS[self.kind]} of {listed(self.of)} {words})"
        parts = {key: float(part) for key, part in parts.items()}
        return MetricResult(self.name, self.label or self.name, float(value), unit, words, parts)


Metric: TypeAlias = "Error | Measure | PhaseError | PortEnergy"


def evaluate(metrics: Iterable[Metric], signals: Signals) -> tuple[MetricResult, ...]:
    """Result of each metric, in order. Raises ScenarioError for one that makes no sense."""
    return tuple(result_of(metric, signals) for metric in metrics)


def result_of(metric: Metric, signals: Signals) -> MetricResult:
    """Result of a metric, computed once for each :class:`Run`. Raises ScenarioError."""
    if isinstance(signals, Run):
        return signals.once(metric, lambda: metric.evaluate(signals))
    return metric.evaluate(signals)


def metric(
    name: str,
    kind: str,
    of: Sequence[str],
    *,
    target: Sequence[float | str] | str | None = None,
    within: float | None = None,
    window: float | None = None,
    contact: Sequence[str] | None = None,
    norm: Distance = "max",
    label: str = "",
    place: str = "",
) -> Metric:
    """The metric a table of the scenario declares (durations in s already).

    Raises ScenarioError at `place` for an unknown kind, or a key it lacks or does not take.
    """
    place = place or f"metrics.{name}"
    if kind not in _KINDS:
        raise ScenarioError(f"unknown kind {kind!r}; expected one of {', '.join(_KINDS)}", place)
    if not of:
        raise ScenarioError("'of' names no signal", place)
    keys = {"target": target, "within": within, "window": window, "contact": contact or None}
    for key, value in keys.items():
        if value is None and key in _NEEDS.get(kind, ()):
            raise ScenarioError(f"kind {kind!r} needs {key!r}", place)
        if value is not None and key not in _TAKES.get(kind, ()):
            raise ScenarioError(f"kind {kind!r} takes no {key!r}", place)
        if isinstance(value, int | float) and not (isfinite(value) and value > 0):
            raise ScenarioError(f"found {value:g}, expected a number above 0", f"{place}.{key}")
    if kind == "error":
        return Error(name, tuple(of), _targets(target, place), within, norm, label)
    if kind in get_args(Kind):
        return Measure(name, cast(Kind, kind), tuple(of), window or 0.0, label)
    from cosim.measure.contact_metrics import PhaseError, PortEnergy

    if kind == "energy":
        return PortEnergy(name, tuple(of), label)
    aim = _targets(target, place)
    if not isinstance(aim, str) and any(isinstance(x, str) for x in aim):
        raise ScenarioError(f"kind {kind!r} takes one signal or numbers as 'target'", place)
    goal = cast("tuple[float, ...] | str", aim)
    return PhaseError(name, cast("Phase", kind), tuple(of), goal, tuple(contact or ()), label)


def _targets(
    given: Sequence[float | str] | str | None, place: str
) -> tuple[float, ...] | tuple[str, ...] | str:
    """A target as given: a signal, signals or numbers. Raises ScenarioError for a mixture."""
    if isinstance(given, str):
        return given
    names = tuple(x for x in given or () if isinstance(x, str))
    if names and len(names) != len(given or ()):
        raise ScenarioError(
            f"found {list(given or ())}, expected numbers or signals", f"{place}.target"
        )
    return names or tuple(float(x) for x in given or ())


def _settled(after: float, label: str, last: float, within: float, unit: str) -> str:
    """The time after which an error settled, `after` s, or its size at the end."""
    band = f"below {with_unit(within, unit, 6)}"
    if after < inf:
        return f"after {time_text(after)} ({label} {band})"
    return f"never ({label} {with_unit(last, unit)} at the end, expected {band})"


def settle_time(E: Array, t: Array, within: float) -> float:
    """Time of the first row, s, from which on E < `within`; inf if the last row is outside.

    `E`, `t`: (n,). NaN counts as outside.
    """
    found = _Settling(within)
    found.add(E, t)
    return found.time


@final
class _Settling:
    """:func:`settle_time` of rows that come in pieces; `time`, s, of those so far."""

    def __init__(self, within: float) -> None:
        self._within, self._settles, self.time = within, True, nan

    def add(self, E: Array, t: Array) -> None:
        """Take the next rows, (n,)."""
        if self._settles and len(t):
            self.time, self._settles = float(t[0]), False
        outside = np.flatnonzero(~(self._within > E))
        if len(outside):
            first = int(outside[-1]) + 1
            self._settles = first == len(t)
            self.time = inf if self._settles else float(t[first])


# ---- measures: rows and window to value, words, parts -------------------------------------------

_Measured = tuple[float, str, Mapping[str, float]]


def _over(s: Stacked) -> str:
    return f"over {time_text(s.last - s.first)}"


def _norm(s: Stacked, _: float) -> _Measured:
    found = Trapezoids(s.rows)
    for rows in s:
        found.add(length(rows.x) ** 2, rows.t)
    return sqrt(found.value), _over(s), {}


def _integral_abs(s: Stacked, _: float) -> _Measured:
    found = Trapezoids(s.rows)
    for rows in s:
        found.add(length(rows.x), rows.t)
    return found.value, _over(s), {}


def _rms(s: Stacked, _: float) -> _Measured:
    found, last = Trapezoids(s.rows), 0.0
    for rows in s:
        size = length(rows.x)
        found.add(size**2, rows.t)
        last = float(abs(size[-1]))
    duration = s.last - s.first
    return (sqrt(found.value / duration) if duration > 0 else last), _over(s), {}


def _tail_mean(s: Stacked, window: float) -> _Measured:
    since, words = _tail(s, window)
    count = sum(int((rows.t >= since).sum()) for rows in _checked(s, since))
    found = PairwiseSum(count)
    for rows in s.since(since):
        found.add(length(rows.x[rows.t >= since]))
    return found.value / count, words, {}


def _checked(s: Stacked, since: float) -> Iterator[Stack]:
    """The rows from a time on, after all were read: whatever is not finite is found."""
    for rows in s:
        if rows.t[-1] >= since:
            yield rows


def _tail(s: Stacked, window: float) -> tuple[float, str]:
    """The time from which the last `window` seconds reach, s, and words for it."""
    words = f"over the last {time_text(window)}"
    if s.last - s.first < window * (1 - 1e-9):
        words = f"{_over(s)}, which is all there is"
    return s.last - window * (1 + 1e-9), words


def _vibration(s: Stacked, window: float) -> _Measured:
    since, words = _tail(s, window)
    least, most = np.full(len(s.names), inf), np.full(len(s.names), -inf)
    for rows in _checked(s, since):
        x = rows.x[rows.t >= since]
        least, most = np.minimum(least, x.min(axis=0)), np.maximum(most, x.max(axis=0))
    swing = most - least
    entry = int(np.argmax(swing))
    middle, crossings = 0.5 * (most[entry] + least[entry]), _Crossings()
    for rows in s.since(since):
        tail = rows.t >= since
        crossings.add(rows.x[tail, entry] - middle, rows.t[tail])
    frequency = crossings.frequency
    words = f"at {frequency:.4g} Hz {words} ({s.names[entry]})"
    return 0.5 * float(swing[entry]), words, {"frequency_hz": frequency}


@final
class _Crossings:
    """The times at which rows that come in pieces cross 0."""

    def __init__(self) -> None:
        self._count, self._first, self._last = 0, nan, nan
        self._x = self._t = np.empty(0)

    def add(self, x: Array, t: Array) -> None:
        """Take the next rows: `x` in its unit, `t`, s, (n,)."""
        x, t = np.concatenate((self._x, x)), np.concatenate((self._t, t))
        before = np.flatnonzero((x[:-1] < 0.0) != (x[1:] < 0.0))
        if len(before):
            ends = before[[0, -1]]
            first, last = t[ends] - x[ends] * (t[ends + 1] - t[ends]) / (x[ends + 1] - x[ends])
            self._first, self._last = first if not self._count else self._first, last
            self._count += len(before)
        self._x, self._t = x[-1:], t[-1:]

    @property
    def frequency(self) -> float:
        """Hz; 0 with less than a period."""
        if self._count < 3:
            return 0.0
        return float(0.5 * (self._count - 1) / (self._last - self._first))


def _peak(s: Stacked, _: float) -> _Measured:
    peak, at, entry = -inf, nan, 0
    for rows in s:
        size = np.abs(rows.x)
        place = int(np.argmax(size))
        if size.flat[place] > peak:
            row, entry = divmod(place, size.shape[1])
            peak, at = float(size[row, entry]), float(rows.t[row])
    return peak, f"at {time_text(at)} ({s.names[entry]})", {"at_s": at}


def _final(s: Stacked, _: float) -> _Measured:
    x = np.zeros((1, len(s.names)))
    for rows in s:
        x = rows.x[-1:]
    last = x[0]
    parts = dict(zip(s.names, last.tolist(), strict=True))
    if len(last) == 1:
        return float(last[0]), f"at the end ({time_text(s.last)})", parts
    entries = with_unit(0.0, s.unit).removeprefix("0")
    entries = f"({', '.join(f'{x:.4g}' for x in last)}){entries}"
    words = f"at the end ({time_text(s.last)}), length of {entries}"
    return float(length(x)[0]), words, parts


#: Sums and means over time in words, for the signals they are of.
_WORDS: Mapping[Kind, str] = {
    "norm": "L2 norm",
    "integral_abs": "integral of the magnitude",
    "rms": "RMS",
    "tail_mean": "mean magnitude",
}
_MEASURES: Mapping[Kind, Callable[[Stacked, float], _Measured]] = {
    "norm": _norm,
    "integral_abs": _integral_abs,
    "rms": _rms,
    "tail_mean": _tail_mean,
    "vibration": _vibration,
    "peak": _peak,
    "final": _final,
}


def _largest(x: Array) -> Array:
    """max_i |x_i| of each row; (n, m) -> (n,)."""
    # max(axis=1) of few columns takes ten times as long
    return reduce(np.maximum, np.abs(x).T, np.zeros(len(x)))
