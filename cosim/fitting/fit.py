"""Least squares between a run and a recording, over parameters within bounds.

The residual of a signal is its difference to the data at the times of the data, divided by the
standard deviation of the data, so that signals of different units count alike. With J the Jacobian
of all m residuals at the result, the covariance of the n parameters is estimated as::

    (J^T J)^-1 J^T C J (J^T J)^-1

and an interval of 95 % is that of Student's t distribution; C are the covariances of the errors,
which depend on each other in time as far as :mod:`cosim.fitting.errors` finds. It holds for a model
that is linear near the result and has no other error than noise.
Source: G. A. F. Seber and C. J. Wild, Nonlinear Regression, Wiley 1989, Sec. 2.1, 5.1 and 6.2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.base.errors import CosimError, RunError, ScenarioError
from cosim.fitting.errors import CorrelatedErrors, errors_of
from cosim.fitting.varied import Varied, with_values
from cosim.record import Column
from cosim.record.recording import Recording
from cosim.schedule.plan import Plan
from cosim.study.memory import record

Array = NDArray[np.float64]
#: Residual, in standard deviations of the data, that stands for a run that stopped.
_STOPPED = 1e3
#: Step of the finite differences, as a fraction of the range of a parameter.
_DIFFERENCE = 1e-5
#: Singular values of the Jacobian below this part of the largest one do not determine anything.
_RANK = 1e-8


@dataclass(frozen=True, slots=True)
class MeasuredSignal:
    """A scalar of the plan, `column`, and what was measured of it: `values` (n,), its unit."""

    column: Column
    values: Array

    @property
    def scale(self) -> float:
        """The standard deviation of the data, or 1 where it is constant."""
        spread = float(np.std(self.values))
        return spread if spread > 0.0 else 1.0


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """A fitted `value` with the half-width of its 95 % confidence interval, in its unit.

    `interval` is NaN where the data do not determine the parameter, or it is at a bound.
    """

    varied: Varied
    value: float
    interval: float
    at_bound: bool


@dataclass(frozen=True, slots=True)
class Fit:
    """The result: parameters, RMS differences (before, after) by signal, in its unit.

    `correlation` (n, n) of the parameters; `runs`: how many runs it took; `converged`, or why not;
    `independent`: of the `values` of each signal, how many would tell as much if their errors were
    independent, by name.
    """

    parameters: tuple[FittedParameter, ...]
    differences: Mapping[str, tuple[float, float, str]]
    correlation: Array
    runs: int
    converged: bool
    reason: str
    independent: Mapping[str, float]
    values: int


def measured(
    plan: Plan, columns: Sequence[Column], data: Recording, names: Mapping[str, str]
) -> tuple[MeasuredSignal, ...]:
    """The scalars of the plan that are in the data, by the same name or as `names` says.

    A column may be named ``component.signal``, or ``signal`` where one component has it. Raises
    ScenarioError for a name that is neither, and if there is none.
    """
    known = {c.name: c for c in columns}
    for name, column in names.items():
        if name not in known:
            raise ScenarioError(f"--match: no signal {name!r}; there are: {', '.join(known)}")
        if column not in data.columns:
            there = ", ".join(data.columns)
            raise ScenarioError(
                f"--match: no column {column!r}; there are: {there}", str(data.path)
            )
    short: dict[str, list[str]] = {}
    for name in known:
        short.setdefault(name.partition(".")[2], []).append(name)
    found = dict(names)
    for column in data.columns:
        alone = short.get(column, [])
        name = column if column in known else alone[0] if len(alone) == 1 else ""
        if name and name not in found and column not in names.values():
            found[name] = column
    signals = tuple(MeasuredSignal(known[n], data.columns[c]) for n, c in sorted(found.items()))
    for s in signals:
        if not np.isfinite(s.values).all():
            raise ScenarioError(f"{found[s.column.name]} is not finite everywhere", str(data.path))
    if not signals:
        raise ScenarioError(
            f"no column is a signal of the scenario; the file has {', '.join(data.columns)}, the "
            f"scenario {', '.join(known)}",
            str(data.path),
        )
    return signals


class Fitting:
    """One fit: a plan, the measured signals at times `t` (n,), s, and the parameters to vary."""

    def __init__(
        self,
        plan: Plan,
        signals: Sequence[MeasuredSignal],
        t: Array,
        parameters: Sequence[Varied],
        progress: Callable[[int, float], None] = lambda runs, rms: None,
    ) -> None:
        self._plan, self._signals, self._t = plan, tuple(signals), t
        self._parameters, self._progress = tuple(parameters), progress
        self._low = np.array([v.low for v in parameters])
        self._range = np.array([v.high for v in parameters]) - self._low
        self._runs = 0

    def run(self, most: int = 1000) -> Fit:
        """Find the parameters, with at most `most` runs. Raises CosimError, ScenarioError.

        The first run must succeed: where the start values cannot be run, nothing can be compared.
        """
        least_squares = _least_squares()
        if self._t.size * len(self._signals) <= len(self._parameters):
            raise ScenarioError("found fewer measured values than parameters, expected more")
        start = (np.array([v.start for v in self._parameters]) - self._low) / self._range
        before = self._differences(start)
        found = least_squares(
            self._residuals, start, bounds=(0.0, 1.0), diff_step=None, jac=self._jacobian,
            x_scale=1.0, ftol=1e-12, xtol=1e-10, gtol=1e-12,
            max_nfev=max(1, most // (1 + len(self._parameters))),
        )  # fmt: skip
        return self._fit(found.x, found.fun, found.jac, before, found.status, str(found.message))

    # ---- one run -----------------------------------------------------------------------------

    def _differences(self, x: Array) -> Array:
        """Differences to the data, (signals, n), in the units of the signals."""
        values = self._low + x * self._range
        plan = replace(
            self._plan, components=tuple(with_values(self._plan, self._parameters, values))
        )
        self._runs += 1
        run = record(plan, [s.column for s in self._signals])
        if run.t[-1] < self._t[-1] - plan.h:
            raise RunError(f"the run ends at {run.t[-1]:g} s, before the data")
        return np.array(
            [
                np.interp(self._t, run.t, run.array(s.column.name)[:, 0]) - s.values
                for s in self._signals
            ]
        )

    def _residuals(self, x: Array) -> Array:
        try:
            differences = self._differences(x)
        except CosimError:  # it does not start with these values, or it stopped
            return np.full(self._t.size * len(self._signals), _STOPPED)
        scale = np.array([s.scale for s in self._signals])
        found: Array = (differences / scale[:, None]).ravel()
        self._progress(self._runs, float(np.sqrt(np.mean(found**2))))
        return found

    def _jacobian(self, x: Array) -> Array:
        """By differences to the side on which there is more room."""
        here = self._residuals(x)
        columns = []
        for i in range(len(x)):
            step = _DIFFERENCE if x[i] < 0.5 else -_DIFFERENCE
            moved = x.copy()
            moved[i] += step
            columns.append((self._residuals(moved) - here) / step)
        return np.stack(columns, axis=1)

    # ---- the result --------------------------------------------------------------------------

    def _fit(
        self, x: Array, r: Array, jacobian: Array, before: Array, status: int, message: str
    ) -> Fit:
        errors = [errors_of(part) for part in r.reshape(len(self._signals), -1)]
        intervals, correlation = _uncertainty(jacobian, errors)
        after = r.reshape(len(self._signals), -1) * np.array([[s.scale] for s in self._signals])
        at_bound = (x < _DIFFERENCE) | (x > 1.0 - _DIFFERENCE)
        x = np.where(at_bound, np.round(x), x)
        parameters = tuple(
            FittedParameter(v, float(self._low[i] + x[i] * self._range[i]),
                            nan if at_bound[i] else float(intervals[i] * self._range[i]),
                            bool(at_bound[i]))
            for i, v in enumerate(self._parameters)
        )  # fmt: skip
        differences = {
            s.column.name: (_rms(before[i]), _rms(after[i]), s.column.unit)
            for i, s in enumerate(self._signals)
        }
        stopped = bool(np.all(r == _STOPPED))
        independent = {
            s.column.name: e.independent for s, e in zip(self._signals, errors, strict=True)
        }
        return Fit(parameters, differences, correlation, self._runs, status > 0 and not stopped,
                   message, independent, self._t.size)  # fmt: skip


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _uncertainty(jacobian: Array, errors: Sequence[CorrelatedErrors]) -> tuple[Array, Array]:
    """(half-widths (n,) of 95 % intervals, correlation (n, n)); NaN what is not determined.

    `errors`: of each signal, in the order of the rows of `jacobian` (m, n).
    """
    from scipy.stats import t as student

    n = jacobian.shape[1]
    _, singular, vt = np.linalg.svd(jacobian, full_matrices=False)
    certain = singular > _RANK * singular[0] if singular[0] > 0.0 else np.zeros(n, dtype=bool)
    inverse = np.where(certain, 1.0 / np.where(certain, singular, 1.0) ** 2, 0.0)
    parts = np.split(jacobian, len(errors))
    middle = sum((e.spread(part) for e, part in zip(errors, parts, strict=True)), np.zeros((n, n)))
    bread = (vt.T * inverse) @ vt
    count = sum(e.independent for e in errors)
    covariance = bread @ middle @ bread * count / max(1.0, count - n)
    lost = np.abs(vt[~certain]).max(axis=0, initial=0.0) > 1e-3  # in directions that show nothing
    deviation = np.where(lost, nan, np.sqrt(np.diag(covariance)))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(deviation, deviation)
    width = float(student.ppf(0.975, max(1.0, count - n)))
    return width * deviation, correlation


def _least_squares() -> Callable[..., Any]:
    try:
        from scipy.optimize import least_squares
    except ImportError:
        raise CosimError("cosim fit needs SciPy: pip install 'cosim-bridge[fit]'") from None
    found: Callable[..., Any] = least_squares
    return found
