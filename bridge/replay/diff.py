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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bridge.replay.aligned import CLOSE, Changes, CommonTime, common_time, rows_within, together
from bridge.replay.run_facts import is_compared, period, quanta, stored_scenario
from cosim.base.copies import asdict, replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import signal_of, unknown
from cosim.measure import declared_metrics
from cosim.measure.metrics import evaluate
from cosim.measure.requirements import of_run
from cosim.measure.robustness import Robustness
from cosim.record import Run
from cosim.record.piecewise import PairwiseSum

Array = NDArray[np.float64]
Verdict = Literal["identical", "equal", "different"]


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
    common, remarks = common_time(first, second), list[str]()
    T = max(period(first, remarks), period(second, remarks))
    steps = quanta(first, remarks) | quanta(second, remarks)
    spans, same = _spans(first, second, max(T, common.step))
    found = [
        replace(
            difference,
            judged=tolerance is not None or all(judge(difference.name) for judge in judges),
        )
        for difference in _differences(first, second, common, names, T, steps, tolerance)
    ]
    return RunDifference(
        a, b, common.rows, common.last, spans, same or not whole, T, tolerance,
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


def _spans(
    a: Run, b: Run, step: float
) -> tuple[tuple[tuple[float, float], tuple[float, float]], bool]:
    """Times of the first and last rows, s; whether they agree to a step (s) of the coarser run.

    A run that was recorded more coarsely may end up to a step before the other, and a twin, which
    has no row at its end, up to a period.
    """
    spans = a.span, b.span
    apart = max(abs(x - y) for x, y in zip(*spans, strict=True))
    return spans, apart < step + CLOSE


def _spanned(name: str, span: tuple[float, float]) -> str:
    """``a is 60 s long``; where it does not begin at 0, from when to when."""
    first, last = span
    return f"{name} is {last:g} s long" if first == 0 else f"{name} is from {first:g} to {last:g} s"


def _differences(
    a: Run,
    b: Run,
    common: CommonTime,
    names: Sequence[str],
    period: float,
    steps: Mapping[str, float],
    tolerance: float | None,
) -> Iterator[SignalDifference]:
    """The difference in each signal; `steps`: of their quantization, `period`: of the bounds, s.

    So many signals are compared at once as are read in no more than a piece.
    """
    within = rows_within(common.rows, common.last - common.first, period)
    most = min(a.columns_at_once, b.columns_at_once)
    for at in range(0, len(names), most):
        yield from _compared(a, b, common, names[at : at + most], within, steps, tolerance)


def _compared(
    a: Run,
    b: Run,
    common: CommonTime,
    names: Sequence[str],
    within: int,
    steps: Mapping[str, float],
    tolerance: float | None,
) -> Iterator[SignalDifference]:
    """The difference in each of some signals; `within`: the rows of a period of the bounds."""
    apart = {name: _Apart(common.rows, within) for name in names}
    for t, x, y in together(a, b, common, names):
        for name, one in apart.items():
            one.add(t, x[name], y[name])
    again = {name: one.again() for name, one in apart.items() if not one.complete}
    for _, x, y in together(a, b, common, [*again]) if again else ():
        for name, changes in again.items():
            changes[0].add(x[name])
            changes[1].add(y[name])
    for name, one in apart.items():
        changes = again.get(name, one.changes)
        rms, most = max(c.rms for c in changes), max(c.largest for c in changes)
        if tolerance is not None:
            rms = most = tolerance
        extra = steps.get(name, 0.0) if tolerance is None else 0.0
        yield SignalDifference(
            name, a.units[name], one.rms, one.largest, one.at, rms + extra, most + extra
        )


class _Apart:
    """The difference of two columns of `count` rows that come in pieces.

    `largest`, in their unit, `at` a time, s; `changes` of each of the two within some rows.
    """

    def __init__(self, count: int, within: int) -> None:
        self._count, self._within = count, within
        self._squares, self._finite = PairwiseSum(count), True
        self.largest, self.at = -inf, 0.0
        self.changes = Changes(count, within), Changes(count, within)

    def add(self, t: Array, x: Array, y: Array) -> None:
        """Take the next rows, (n,)."""
        d = np.abs(y - x)
        d[(x == y) | (np.isnan(x) & np.isnan(y))] = 0.0
        d[np.isnan(d)] = inf
        worst = int(np.argmax(d))
        if d[worst] > self.largest:
            self.largest, self.at = float(d[worst]), float(t[worst])
        self._finite = self._finite and bool(np.isfinite(d).all())
        self._squares.add(d * d)
        self.changes[0].add(x)
        self.changes[1].add(y)

    @property
    def complete(self) -> bool:
        """True if the changes of both have their RMS."""
        return all(change.complete for change in self.changes)

    def again(self) -> tuple[Changes, Changes]:
        """The changes for another pass over both columns."""
        first, second = (Changes(self._count, self._within, c.finite) for c in self.changes)
        return first, second

    @property
    def rms(self) -> float:
        """RMS of the difference, in its unit."""
        return float(np.sqrt(self._squares.value / self._count)) if self._finite else inf


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
