"""The requirements a scenario declares, made once and evaluated on recorded signals.

A requirement reads recorded signals, or metrics of the scenario by the names that a sweep gives
them (``sync.settle_s``). All of them have one result, :class:`Robustness`, wherever it is shown.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf, isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import unknown
from cosim.base.units import parse, time_text
from cosim.formulas.robust import Both, Extreme, HeldInequality, Not, Until
from cosim.formulas.syntax import Connective, Formula, Inequality, Temporal, comparisons
from cosim.formulas.terms import Binder, Known, Lookup, Term, shown_unit
from cosim.formulas.tokens import FormulaError
from cosim.formulas.trace import RecordedTrace, Robust
from cosim.measure import declared_metrics
from cosim.measure.declared_metrics import Preview
from cosim.measure.metric_result import MetricResult, with_unit
from cosim.measure.metrics import Metric, result_of
from cosim.measure.robustness import Robustness, Verdict, stopped, undecided
from cosim.record import Run, seal, write_metadata
from cosim.record.folder import METADATA, read_metadata
from cosim.record.piecewise import RunRows, extent
from cosim.record.signals import Array, Signals
from cosim.scenario.spec import Scenario

if TYPE_CHECKING:
    from cosim.formulas.in_pieces import LongTrace

#: Rows that may be missing at the end of a run: that of its last time, which some runs do not have.
MISSING = 1.5
#: The end of the name of a settle time.
SETTLES = ".settle_s"
#: What the time of a result is called, by the outermost operator and whether it holds.
_CALLED = {("always", True): "closest", ("always", False): "worst"}
_CALLED |= {("eventually", True): "best", ("eventually", False): "closest"}


class Requirement(Struct, frozen=True):
    """A requirement, ready to be evaluated any number of times.

    `signals`: names of the signals it reads; `metrics`: of those that it is about, empty for one
    about signals; `unit`: of its margin, ``1`` and `relative` if it compares different units: then
    each margin is a share of its bound.
    """

    name: str
    condition: str
    unit: str
    relative: bool
    formula: Robust
    names: tuple[str, ...]
    word: str = ""
    metrics: tuple[Metric, ...] = ()
    terms: tuple[Term, ...] = ()

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the recorded signals that it reads."""
        if not self.metrics:
            return self.names
        return tuple(dict.fromkeys(s for metric in self.metrics for s in metric.signals))

    def evaluate(
        self, signals: Signals, end: float | None = None, measured: Iterable[MetricResult] = ()
    ) -> Robustness:
        """The robustness on recorded signals.

        `end`: the time at which the run should end, s; None: with its last row. Of one that ended
        before, the result is inconclusive if what is missing could change the verdict. `measured`:
        results of metrics of the scenario on these signals, which are not computed again. Raises
        ScenarioError for signals that are not there.
        """
        count, begin, last = extent(signals)
        if not count:
            return self._undecided("nothing was recorded")
        step = (last - begin) / max(1, count - 1)
        covered, end = _covered(last, end, step)
        if self.metrics:
            return self._of_metrics(signals, covered, end, measured)
        trace = self._trace(signals, end, None)
        high = low = trace.at_first(self.formula)
        if covered < end or begin + self.formula.tail > covered + 1e-9 * (covered - begin):
            trace, other = (self._trace(signals, end, beyond) for beyond in (1, -1))
            high, low = trace.at_first(self.formula), other.at_first(self.formula)
            if high == inf:
                trace = other
        value, row = trace.at_first(self.formula), trace.decisive(self.formula)
        if row is None:
            return self._undecided(
                f"its interval is beyond the end of the run at {time_text(covered)}"
            )
        if low < 0 <= high:
            text = f"{self._margin(value)} when the run ended at {time_text(covered)}"
            return self._result("inconclusive", value, row.time, text)
        if not isfinite(value):
            text = f"{self._bad(signals, row.number)} at {time_text(row.time)}"
            return self._result("failed", -inf, row.time, text)
        called = _CALLED.get((self.word, value >= 0), "decided")
        text = f"{self._margin(value)}, {called} at {time_text(row.time)}"
        return self._result("passed" if value >= 0 else "failed", value, row.time, text)

    def _trace(self, signals: Signals, end: float, beyond: int | None) -> RecordedTrace | LongTrace:
        """The signals until the `end` of the run, s, and `beyond` it."""
        count, begin, last = extent(signals)
        step = (last - begin) / max(1, count - 1)
        if not isinstance(signals, Run) or not signals.is_long:
            t = np.asarray(signals.t, dtype=np.float64)
            return RecordedTrace(t, _lookup(signals), end, beyond, step)

        from cosim.formulas.in_pieces import LongTrace

        def pieces(names: Sequence[str], since: float) -> Iterator[tuple[Array, Lookup]]:
            for piece in signals.pieces(names, since, backwards=True):
                yield piece.t, _lookup(piece)

        return LongTrace(pieces, count, begin, end, beyond, step)

    def stopped(self, time: float, why: str = "the run stopped") -> Robustness:
        """The result on a run that diverged or failed at a time, s."""
        return stopped(self.name, self.unit, time, why, self.condition)

    def _of_metrics(
        self, signals: Signals, covered: float, end: float, measured: Iterable[MetricResult]
    ) -> Robustness:
        """The robustness of numbers of the whole run: a trace of one row."""
        if covered < end:
            return self._undecided(f"the run ended at {time_text(covered)} of {time_text(end)}")
        known = {result.name: result for result in measured}
        results = [known.get(m.name) or result_of(m, signals) for m in self.metrics]
        numbers = {name: (nan, "1") for name in self.names}  # of a metric without a number
        numbers |= {name: found for r in results for name, found in r.numbers.items()}
        found = ", ".join(_told(name, *numbers[name]) for name in self.names)
        value = self._of_numbers({name: x for name, (x, _) in numbers.items()})
        if isfinite(value):
            verdict: Verdict = "passed" if value >= 0 else "failed"
            return self._result(verdict, value, nan, f"{self._margin(value)}, {found}")
        if self._of_numbers({n: _at_best(n, x, end) for n, (x, _) in numbers.items()}) >= 0:
            return self._undecided(f"{found} of the run at {time_text(end)}")
        missing = [r.text for r in results if r.value != r.value]
        return self._result("failed", -inf, nan, missing[0] if missing else found)

    def _of_numbers(self, numbers: Mapping[str, float]) -> float:
        """The robustness of metrics, of which `numbers` has each in its unit."""
        trace = RecordedTrace(np.zeros(1), lambda name: np.array([[numbers[name]]]), 0.0)
        return trace.at(self.formula, 0)

    def _bad(self, signals: Signals, row: int) -> str:
        """The signal that is not a finite number in a row."""
        if isinstance(signals, Run):
            scalars = [entry for name in self.names for entry in signals.entries(name)]
            signals, row = RunRows(signals, scalars, np.array([row])), 0
        for name in self.names:
            x = _lookup(signals)(name)[:, row]
            if not np.isfinite(x).all():
                entry = int(np.argmin(np.isfinite(x)))
                return f"{name}{f'[{entry}]' if len(x) > 1 else ''} is {x[entry]}"
        return "the margin is not a finite number"

    def _margin(self, value: float) -> str:
        text = f"margin {with_unit(value, self.unit, 4)}"
        return f"{text} of its bound" if self.relative else text

    def _undecided(self, why: str) -> Robustness:
        return undecided(self.name, self.unit, why, self.condition)

    def _result(self, verdict: Verdict, value: float, time: float, text: str) -> Robustness:
        return Robustness(
            self.name, verdict, value, self.unit, time, f"{verdict}, {text}", self.condition
        )


def _lookup(signals: Signals) -> Lookup:
    return lambda name: np.asarray(signals.array(name), dtype=np.float64).T


def _told(name: str, value: float, unit: str) -> str:
    """A number of a metric in a sentence."""
    if value == inf and name.endswith(SETTLES):
        return f"{name.removesuffix(SETTLES)} has not settled at the end"
    return f"{name} is {with_unit(value, unit, 4)}"


def _at_best(name: str, value: float, end: float) -> float:
    """A number of a metric; a settle time that did not come is at best the end of the run, s."""
    return end if value == inf and name.endswith(SETTLES) else value


def _covered(last: float, end: float | None, step: float) -> tuple[float, float]:
    """The time until which a run is known, and its end, s; `step`: between its rows, s."""
    if end is None or end <= last:
        return last, last
    return (end, last) if end - last <= MISSING * step else (last, end)


# ---- from the scenario --------------------------------------------------------------------------


def requirements(scenario: Scenario, units: Mapping[str, str]) -> list[Requirement]:
    """The scenario's requirements. `units`: of each recorded scalar by its name.

    Raises ScenarioError with the place and the column: an unknown signal, a unit that does not fit.
    """
    if not scenario.require:
        return []
    preview = Preview(units)
    metrics = _measured(scenario, preview) if _about_metrics(scenario) else {}
    return [_requirement(scenario, name, preview, metrics) for name in scenario.require]


def _about_metrics(scenario: Scenario) -> bool:
    return any(spec.form == "metric" for spec in scenario.require.values())


def _measured(scenario: Scenario, preview: Preview) -> dict[str, tuple[Metric, str]]:
    """Metrics of the scenario, whose signals are recorded, and units, by the names of numbers."""
    found: dict[str, tuple[Metric, str]] = {}
    for metric in declared_metrics.metrics(scenario):
        try:
            result = metric.evaluate(preview)
        except ScenarioError:
            continue
        found |= {name: (metric, unit) for name, (_, unit) in result.numbers.items()}
    return found


def _requirement(
    scenario: Scenario, name: str, preview: Preview, measured: Mapping[str, tuple[Metric, str]]
) -> Requirement:
    spec = scenario.require[name]
    place = scenario.place("require", name)
    tree = spec.tree(place)

    def known(of: str) -> Known:
        if spec.form != "metric":
            return Known(len(preview.entries(of)), preview.unit(of))
        if of not in measured:
            raise ScenarioError(unknown(of, measured, "metric"))
        return Known(1, measured[of][1])

    try:
        compared = comparisons(tree)
        binder = Binder(spec.text, known)
        terms = {id(node): binder.margin(node) for node in compared}
        unit, scales = _scales(spec.text, compared, [terms[id(node)] for node in compared])
    except FormulaError as error:
        raise ScenarioError(str(error), f"{place}.{spec.form}") from None
    of = dict(zip(terms, scales, strict=True))
    formula = _robust(tree, {key: (term, of[key]) for key, term in terms.items()}, False)
    if spec.form == "metric" and isinstance(tree, Temporal):
        raise ScenarioError("a metric is of the whole run", f"{place}.metric")
    names = tuple(dict.fromkeys(n for term in terms.values() for n in term.names))
    used = [measured[n][0] for n in names] if spec.form == "metric" else []
    return Requirement(
        name, spec.condition, unit or "1", not unit, formula, names,
        tree.word if isinstance(tree, Temporal) else "",
        tuple({metric.name: metric for metric in used}.values()), tuple(terms.values()),
    )  # fmt: skip


def _scales(
    text: str, nodes: Sequence[Inequality], terms: Sequence[Term]
) -> tuple[str, list[float]]:
    """The unit of the margin, and what each comparison divides its margin by; "": a share of its
    bound, where the comparisons have different units.
    """
    if len({term.exponents[:-1] for term in terms}) == 1:
        unit = next((term.unit for term in terms if term.unit), "") or shown_unit(terms[0])
        return unit, [parse(unit).factor] * len(terms)
    scales = []
    for node, term in zip(nodes, terms, strict=True):
        bounds = [b for b in (part.constant for part in term.of) if b]
        if not bounds:
            raise FormulaError(
                f"found [{shown_unit(term)}] beside other units and no bound to divide by; expected"
                " a number other than 0",
                node.column, text,
            )  # fmt: skip
        scales.append(bounds[0])
    return "", scales


def _robust(node: Formula, terms: Mapping[int, tuple[Term, float]], negated: bool) -> Robust:
    """The formula with terms for its comparisons; `negated`: by an odd number of ``not``."""
    if isinstance(node, Inequality):
        return HeldInequality(*terms[id(node)], negated)
    first = isinstance(node, Connective) and node.word in ("not", "implies")
    of = [_robust(x, terms, negated ^ (first and not i)) for i, x in enumerate(node.of)]
    if isinstance(node, Temporal):
        if node.word == "until":
            return Until(of[0], of[1], node.interval)
        return Extreme(of[0], node.interval, node.word == "eventually")
    if node.word == "not":
        return Not(of[0])
    left = Not(of[0]) if node.word == "implies" else of[0]
    return Both(left, of[1], node.word != "and")


# ---- of recorded runs ---------------------------------------------------------------------------


def evaluate(
    found: Iterable[Requirement], signals: Signals, end: float | None = None
) -> tuple[Robustness, ...]:
    """The robustness of each requirement, in order; `end` of the run, s."""
    return tuple(requirement.evaluate(signals, end) for requirement in found)


def of_run(scenario: Scenario, run: Run, failed_at: float | None = None) -> tuple[Robustness, ...]:
    """The robustness of the scenario's requirements on a run folder.

    A run that stopped with an error violates all of them; of one that was cut short what is missing
    is taken into account. A requirement whose signals were not recorded is inconclusive.
    `failed_at`: the time at which a part of the run failed, s; None: as its ``run.json`` says.
    """
    facts = run.metadata
    units = {name: unit for name, unit in run.units.items() if name != "t"}
    ticks, step = facts.get("ticks"), facts.get("step")
    end = facts.get("start", 0.0) + ticks * step if ticks and step else None
    error = str(facts.get("error") or "")
    last = extent(run)[2]
    if failed_at is None:
        failed_at = facts.get("failed_at", last if error else None)
    preview = Preview(units)
    metrics = _measured(scenario, preview) if _about_metrics(scenario) else {}
    results = []
    for name in scenario.require:
        try:
            requirement = _requirement(scenario, name, preview, metrics)
        except CosimError as missing:
            why = str(missing).partition(": ")[2] or str(missing)
            found = undecided(name, "1", why, scenario.require[name].condition)
            results.append(replace(found, recorded=False))
            continue
        if failed_at is not None and not error.startswith("Interrupted"):
            results.append(requirement.stopped(failed_at))
        else:
            results.append(requirement.evaluate(run, end))
    return tuple(results)


def keep(folder: Path, results: Iterable[Robustness]) -> None:
    """Write the results into ``run.json`` of a run folder, which is sealed again.

    Raises RunError if it cannot be written.
    """
    found = as_data(results)
    if found:
        write_metadata(folder, read_metadata(folder) | {"requirements": found})
        seal(folder, changed=[METADATA])


def as_data(results: Iterable[Robustness]) -> dict[str, Any]:
    """The results by name, for JSON."""
    return {result.name: result.as_data() for result in results}
