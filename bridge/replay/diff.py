"""Comparison of two runs (offline, twin, rehearsal or hardware): differences and a verdict.

The runs are compared on the rows of the run with fewer rows, over their common time; the other run
holds its last value. Runs that begin or end more than a period apart are *different*. Two other
runs of one scenario are *equal* if their difference is at most the change of either run within one
period, plus a step of the quantization::

    d(t) = b(t) - a(t),   v(t) = x(t + T) - x(t) for x = a, b
    RMS(d) <= RMS(v) + LSB   and   max |d| <= max |v| + LSB

T is the slowest component's period (s), LSB that of the message that carries the signal, if there
is one. Signals that are not sent (a controller's estimates and states) are listed without a
verdict, because they integrate every difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bridge.replay.run_facts import is_compared, period, quanta, stored_scenario
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import signal_of, unknown
from cosim.measure import declared_metrics
from cosim.measure.metrics import evaluate
from cosim.measure.requirements import of_run
from cosim.measure.robustness import Robustness
from cosim.record import Run

Array = NDArray[np.float64]
Verdict = Literal["identical", "equal", "different"]
#: Times of rows that are closer than this are one, s.
CLOSE = 1e-9


@dataclass(frozen=True, slots=True)
class SignalDifference:
    """The difference of two runs in one scalar; `at`: time of the largest difference, s.

    `bound_rms`, `bound`: limits of RMS and maximum for equal runs. `judged`: whether the limits
    apply.
    """

    name: str
    unit: str
    rms: float
    largest: float
    at: float
    bound_rms: float
    bound: float
    judged: bool = True

    @property
    def within(self) -> bool:
        """True if it is within its bounds, or need not be."""
        near = self.rms <= self.bound_rms and self.largest <= self.bound
        return near or not self.judged


@dataclass(frozen=True, slots=True)
class MetricDifference:
    """A number of the summary in both runs; settle times are separate metrics, in s."""

    label: str
    unit: str
    a: float
    b: float


@dataclass(frozen=True, slots=True)
class RequirementDifference:
    """A requirement that both scenarios declare alike, with its result on both runs."""

    name: str
    condition: str
    a: Robustness
    b: Robustness

    @property
    def changed(self) -> bool:
        """True if the runs have different verdicts."""
        return self.a.verdict != self.b.verdict

    @property
    def text(self) -> str:
        """Both verdicts with their margins."""
        word = "changed: " if self.changed else ""
        return f"{word}{self.a.text} -> {self.b.text}"


@dataclass(frozen=True, slots=True)
class RunDifference:
    """The difference of two runs: `signals`, the largest differences by their bounds first.

    `t_end`: the end of their common time, s; `spans`: times of the first and last row of a and b,
    s; `period`: T of the bounds, s; `tolerance`: in place of all bounds, in each signal's unit;
    `only`: signals that one of them lacks, (a, b).
    """

    a: Path
    b: Path
    rows: int
    t_end: float
    spans: tuple[tuple[float, float], tuple[float, float]]
    same_span: bool
    period: float
    tolerance: float | None
    signals: tuple[SignalDifference, ...]
    metrics: tuple[MetricDifference, ...]
    requirements: tuple[RequirementDifference, ...]
    only: tuple[tuple[str, ...], tuple[str, ...]]
    remarks: tuple[str, ...]

    @property
    def names(self) -> tuple[str, str]:
        """The names of both folders; their paths if they have the same name."""
        if self.a.name != self.b.name:
            return self.a.name, self.b.name
        return str(self.a), str(self.b)

    @property
    def verdict(self) -> Verdict:
        """Identical to the bit, equal within the bounds, or different."""
        return self._in_common if self.same_span else "different"

    @property
    def _in_common(self) -> Verdict:
        """The verdict over the common time."""
        if all(s.largest == 0.0 for s in self.signals):
            return "identical"
        return "equal" if all(s.within for s in self.signals) else "different"

    @property
    def exit_code(self) -> int:
        """0, or 1 where they are different."""
        return int(self.verdict == "different")

    def sentence(self) -> str:
        """The verdict, with the limit that determines it."""
        if self.verdict == "different":
            return f"different: {self.reason()}"
        return f"{self.verdict} {self.reason()}"

    def reason(self) -> str:
        """The limit that determines the verdict; for runs of different times, these as well."""
        found = self._reason()
        if self.same_span:
            return found
        begin = max(first for first, _ in self.spans)
        if self._in_common != "different":
            found = f"{self._in_common} {found}"
        common = f"{found} over the common {self.t_end - begin:g} s"
        return "; ".join([common, *map(_spanned, self.names, self.spans)])

    def _reason(self) -> str:
        found = self._in_common
        if found == "identical":
            return f"to the bit in {len(self.signals)} signals, {self.rows} rows"
        bound = f"quantisation and one period ({self.period * 1e3:g} ms)"
        if self.tolerance is not None:
            bound = f"{self.tolerance:g} of each signal's unit"
        if found == "equal":
            return f"within {bound}"
        beyond = [s.name for s in self.signals if not s.within]
        judged = sum(s.judged for s in self.signals)
        return (
            f"{len(beyond)} of {judged} signals are further apart than {bound}, most of all "
            f"{beyond[0]}"
        )

    def as_data(self) -> dict[str, Any]:
        """For JSON."""
        data = asdict(self) | {"a": str(self.a), "b": str(self.b)}
        data["requirements"] = {
            r.name: {"a": r.a.as_data(), "b": r.b.as_data(), "changed": r.changed}
            for r in self.requirements
        }
        return data | {"verdict": self.verdict, "sentence": self.sentence()}


def compare_runs(
    a: Path,
    b: Path,
    signals: Sequence[str] = (),
    tolerance: float | None = None,
    *,
    whole: bool = True,
) -> RunDifference:
    """Compare two run folders, over their common time only if not `whole`.

    `signals`: only these, by name or by what their names begin with; `tolerance`: in place of all
    bounds, in the unit of each signal. Raises ScenarioError for a
    folder that is no run, and where the two have no signal or no time in common.
    """
    first, second = Run.open(a), Run.open(b)
    judges = [is_compared(run) for run in (first, second)]
    names = [n for n in first.names if n in second.units and _is_selected(n, signals)]
    if not names:
        both = {signal_of(name) for name in first.names if name in second.units}
        text = unknown(", ".join(signals) or "*", both, "signal of both runs")
        raise ScenarioError(text, f"{a}, {b}")
    rows, remarks = _rows(first, second), list[str]()
    T = max(period(first, remarks), period(second, remarks))
    steps = quanta(first, remarks) | quanta(second, remarks)
    t, (spans, same) = first.t[rows[0]], _spans(first, second, T)
    found = [
        replace(
            _difference(first, second, name, rows, t, T, steps.get(name, 0.0), tolerance),
            judged=tolerance is not None or all(judge(name) for judge in judges),
        )
        for name in names
    ]
    return RunDifference(
        a, b, len(t), float(t[-1]), spans, same or not whole, T, tolerance,
        tuple(sorted(found, key=lambda s: (not s.judged, -_share(s), -s.largest, s.name))),
        _metrics(first, second), _requirements(first, second),
        (_missing_signals(first, second), _missing_signals(second, first)),
        tuple(dict.fromkeys(remarks)),
    )  # fmt: skip


def _is_selected(name: str, signals: Sequence[str]) -> bool:
    """True if a scalar is one of these, an entry of one, or a port of one."""
    return not signals or any(
        name == s
        or name.startswith((f"{s}[", f"{s}."))
        or (s and s[-1] in ".[" and name.startswith(s))
        for s in signals
    )


def _missing_signals(run: Run, other: Run) -> tuple[str, ...]:
    return tuple(n for n in run.names if n not in other.units)


def _share(s: SignalDifference) -> float:
    """The share of its bound."""
    if s.bound_rms > 0.0:
        return s.rms / s.bound_rms
    return inf if s.rms > 0.0 else 0.0


# ---- rows ---------------------------------------------------------------------------------------


def _rows(a: Run, b: Run) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of a and b that belong together, on the coarser of the two. Raises ScenarioError."""
    ta, tb = a.t, b.t
    if not len(ta) or not len(tb):
        raise ScenarioError("a run without rows", f"{a.path}, {b.path}")
    begin, end = max(ta[0], tb[0]) - CLOSE, min(ta[-1], tb[-1]) + CLOSE
    inside = [t[(t >= begin) & (t <= end)] for t in (ta, tb)]
    grid = min(inside, key=len)
    if not len(grid):
        raise ScenarioError("the runs have no time in common", f"{a.path}, {b.path}")
    held = [np.searchsorted(t, grid + CLOSE, side="right") - 1 for t in (ta, tb)]
    return held[0], held[1]


def _spans(
    a: Run, b: Run, period: float
) -> tuple[tuple[tuple[float, float], tuple[float, float]], bool]:
    """Times of the first and last rows, s; whether they agree to a step of the coarser run.

    A run that was recorded more coarsely may end up to a step before the other, and a twin, which
    has no row at its end, up to a period (s).
    """
    spans = [(float(run.t[0]), float(run.t[-1])) for run in (a, b)]
    step = max(period, *(float(np.diff(run.t).max(initial=0.0)) for run in (a, b)))
    apart = max(abs(x - y) for x, y in zip(*spans, strict=True))
    return (spans[0], spans[1]), apart < step + CLOSE


def _spanned(name: str, span: tuple[float, float]) -> str:
    """``a is 60 s long``; where it does not begin at 0, from when to when."""
    first, last = span
    return f"{name} is {last:g} s long" if first == 0 else f"{name} is from {first:g} to {last:g} s"


def _difference(
    a: Run,
    b: Run,
    name: str,
    rows: tuple[NDArray[np.int64], NDArray[np.int64]],
    t: Array,
    period: float,
    quantum: float,
    tolerance: float | None,
) -> SignalDifference:
    x, y = a.column(name)[rows[0]], b.column(name)[rows[1]]
    d = np.abs(y - x)
    d[(x == y) | (np.isnan(x) & np.isnan(y))] = 0.0
    d[np.isnan(d)] = inf
    worst = int(np.argmax(d))
    rms, most = (
        (tolerance, tolerance) if tolerance is not None else within_a_period(t, (x, y), period)
    )
    extra = quantum if tolerance is None else 0.0
    return SignalDifference(
        name, a.units[name], _rms(d), float(d[worst]), float(t[worst]), rms + extra, most + extra
    )


def _rms(d: Array) -> float:
    return float(np.sqrt(np.mean(d * d))) if np.isfinite(d).all() else inf


def within_a_period(t: Array, signals: Iterable[Array], period: float) -> tuple[float, float]:
    """RMS and maximum of what signals (n,) at the times `t` (n,) change by within a period, s."""
    if len(t) < 2:
        return 0.0, 0.0
    n = max(1, round(period * (len(t) - 1) / (t[-1] - t[0])))
    changes = [np.abs(x[n:] - x[:-n]) for x in signals]
    changes = [v[np.isfinite(v)] for v in changes]
    changes = [v for v in changes if v.size]
    if not changes:
        return 0.0, 0.0
    return max(_rms(v) for v in changes), max(float(v.max()) for v in changes)


def _metrics(a: Run, b: Run) -> tuple[MetricDifference, ...]:
    """Metrics both scenarios declare alike; none where a run does not say what it is of."""
    try:
        scenarios = [stored_scenario(run) for run in (a, b)]
        if scenarios[0].metrics != scenarios[1].metrics:
            return ()
        results = [
            evaluate(declared_metrics.metrics(s), run)
            for s, run in zip(scenarios, (a, b), strict=True)
        ]
    except CosimError:
        return ()
    found = []
    for x, y in zip(*results, strict=True):
        found.append(MetricDifference(x.label, x.unit, x.value, y.value))
        if "settle_s" in x.parts and "settle_s" in y.parts:
            settled = (x.parts["settle_s"], y.parts["settle_s"])
            found.append(MetricDifference(f"{x.label}, settles", "s", *settled))
    return tuple(found)


def _requirements(a: Run, b: Run) -> tuple[RequirementDifference, ...]:
    """Requirements that both scenarios declare alike; none where a run lacks its scenario."""
    try:
        first, second = (stored_scenario(run) for run in (a, b))
        found = {r.name: r for r in of_run(second, b)}
        return tuple(
            RequirementDifference(r.name, r.condition, r, found[r.name])
            for r in of_run(first, a)
            if second.require.get(r.name) == first.require[r.name]
        )
    except CosimError:
        return ()
