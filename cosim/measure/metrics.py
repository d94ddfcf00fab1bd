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

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.base.names import listed
from cosim.base.units import time_text
from cosim.measure.metric_result import MetricResult as MetricResult
from cosim.measure.metric_result import (
    integral,
    interval_text,
    length,
    root_mean_square,
    times,
    with_unit,
)
from cosim.record.signals import Array, Signals, Stack, stack

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


@dataclass(frozen=True, slots=True)
class Error:
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
        place = f"metrics.{self.name}"
        whole = stack(signals, self.signals, place)
        ends = np.cumsum([len(signals.entries(name)) for name in self.signals])
        each = np.split(whole.x, ends[:-1], axis=1)  # (n, m) of each signal, the targets' last
        targets = self._target(each, place)
        if whole.problem:
            return MetricResult(self.name, self.label or self.name, nan, whole.unit, whole.problem)
        distance = _largest if self.norm == "max" else length
        t = whole.t
        pairs = zip(each[: len(self.of)], targets, strict=True)
        E = np.max([distance(x - target) for x, target in pairs], axis=0)
        worst, rmse = int(np.argmax(E)), root_mean_square(E, whole.t)
        parts = {"final": E[-1], "rmse": rmse, "max": E[worst], "max_at_s": t[worst]}
        label, unit = self.label or self.name, whole.unit
        peak = f"{with_unit(E[worst], unit)} at {time_text(t[worst])}"
        more = [
            (f"{label}, RMS", f"{with_unit(rmse, unit)} {interval_text(t)}"),
            (f"{label}, peak", peak),
        ]
        if self.within is not None:
            parts["settle_s"] = settle = settle_time(E, t, self.within)
            more.append(("settled", _settled(settle - t[0], label, E[-1], self.within, unit)))
        parts = {key: float(value) for key, value in parts.items()}
        words = f"at the end ({time_text(t[-1])})"
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


@dataclass(frozen=True, slots=True)
class Measure:
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
        s = stack(signals, self.of, f"metrics.{self.name}")
        unit = times(s.unit, {"norm": "√s", "integral_abs": "s"}.get(self.kind, ""))
        if s.problem:
            return MetricResult(self.name, self.label or self.name, nan, unit, s.problem)
        value, words, parts = _MEASURES[self.kind](s, self.window)
        if self.kind in _WORDS:
            words = f"({_WORDS[self.kind]} of {listed(self.of)} {words})"
        parts = {key: float(part) for key, part in parts.items()}
        return MetricResult(self.name, self.label or self.name, float(value), unit, words, parts)


Metric: TypeAlias = "Error | Measure | PhaseError | PortEnergy"


def evaluate(metrics: Iterable[Metric], signals: Signals) -> tuple[MetricResult, ...]:
    """Result of each metric, in order. Raises ScenarioError for one that makes no sense."""
    return tuple(metric.evaluate(signals) for metric in metrics)


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
    outside = np.flatnonzero(~(within > E))
    if not len(outside):
        return float(t[0]) if len(t) else nan
    first = int(outside[-1]) + 1
    return float(t[first]) if first < len(t) else inf


# ---- measures: stack and window to value, words, parts ------------------------------------------

_Measured = tuple[float, str, Mapping[str, float]]


def _norm(s: Stack, _: float) -> _Measured:
    return sqrt(integral(length(s.x) ** 2, s.t)), interval_text(s.t), {}


def _integral_abs(s: Stack, _: float) -> _Measured:
    return integral(length(s.x), s.t), interval_text(s.t), {}


def _rms(s: Stack, _: float) -> _Measured:
    return root_mean_square(length(s.x), s.t), interval_text(s.t), {}


def _tail_mean(s: Stack, window: float) -> _Measured:
    tail, words = _tail(s, window)
    return float(length(s.x[tail]).mean()), words, {}


def _tail(s: Stack, window: float) -> tuple[NDArray[np.bool_], str]:
    """A mask (n,) of the rows in the last `window` seconds, and words for it."""
    words = f"over the last {time_text(window)}"
    if s.t[-1] - s.t[0] < window * (1 - 1e-9):
        words = f"{interval_text(s.t)}, which is all there is"
    return s.t >= s.t[-1] - window * (1 + 1e-9), words


def _vibration(s: Stack, window: float) -> _Measured:
    tail, words = _tail(s, window)
    x, t = s.x[tail], s.t[tail]
    swing = np.ptp(x, axis=0)
    entry = int(np.argmax(swing))
    frequency = _frequency(x[:, entry] - 0.5 * (x[:, entry].max() + x[:, entry].min()), t)
    words = f"at {frequency:.4g} Hz {words} ({s.names[entry]})"
    return 0.5 * float(swing[entry]), words, {"frequency_hz": frequency}


def _frequency(x: Array, t: Array) -> float:
    """Hz, of `x` (n,) by the times `t` (n,) at which it crosses 0; 0 with less than a period."""
    before = np.flatnonzero((x[:-1] < 0.0) != (x[1:] < 0.0))
    if len(before) < 3:
        return 0.0
    ends = before[[0, -1]]
    first, last = t[ends] - x[ends] * (t[ends + 1] - t[ends]) / (x[ends + 1] - x[ends])
    return float(0.5 * (len(before) - 1) / (last - first))


def _peak(s: Stack, _: float) -> _Measured:
    row, entry = divmod(int(np.argmax(np.abs(s.x))), s.x.shape[1])
    words = f"at {time_text(s.t[row])} ({s.names[entry]})"
    return abs(float(s.x[row, entry])), words, {"at_s": s.t[row]}


def _final(s: Stack, _: float) -> _Measured:
    last = s.x[-1]
    parts = dict(zip(s.names, last.tolist(), strict=True))
    if len(last) == 1:
        return float(last[0]), f"at the end ({time_text(s.t[-1])})", parts
    entries = with_unit(0.0, s.unit).removeprefix("0")
    entries = f"({', '.join(f'{x:.4g}' for x in last)}){entries}"
    words = f"at the end ({time_text(s.t[-1])}), length of {entries}"
    return float(length(s.x[-1:])[0]), words, parts


#: Sums and means over time in words, for the signals they are of.
_WORDS: Mapping[Kind, str] = {
    "norm": "L2 norm",
    "integral_abs": "integral of the magnitude",
    "rms": "RMS",
    "tail_mean": "mean magnitude",
}
_MEASURES: Mapping[Kind, Callable[[Stack, float], _Measured]] = {
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
    largest = np.zeros(len(x))
    for entry in np.abs(x).T:  # max(axis=1) of few columns takes ten times as long
        np.maximum(largest, entry, out=largest)
    return largest
