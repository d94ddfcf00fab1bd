"""The position error of two arms aligned by the delay of the link between them.

    [columns.position-aligned]              # of a variants file
    kind = "rms_aligned"
    of = ["master.q"]                       # of the arm of the role that sends
    target = "slave.q"                      # of the arm of the role that receives

With x_1 and x_2 the entries of these signals and T the mean delay of the link,

    rms_aligned = sqrt(∫ |x_1(t - T) - x_2(t)|² dt / (t_n - T)), over [T, t_n].

T is the mean age of the samples that the receiver had, over all of its looks from the first sample
on, in the run's own link table. So it needs no position on the link: a run knows the positions of
both arms, whatever its controllers send. Values between two recorded rows are linear.

The mean as the shift, where the delay varies, is a choice of this project.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan, sqrt

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.comparison.spec import AlignedSpec
from cosim.measure.metric_result import MetricResult, length
from cosim.record.piecewise import NotFinite, Stacked, Trapezoids
from cosim.record.signals import Signals

KIND = "rms_aligned"


@dataclass(frozen=True, slots=True)
class AlignedError:
    """RMS of the distance of `target` from `of`, a mean delay earlier; of the link `channel`."""

    name: str
    of: str
    target: str
    channel: str

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals it reads."""
        return (self.of, self.target)

    def evaluate(self, signals: Signals, delay: float) -> MetricResult:
        """The root mean square; `delay`: T, s, NaN where the link carried nothing (``delay_s``).

        Raises ScenarioError for signals of different size.
        """
        place, parts = f"columns.{self.name}", {"delay_s": delay}
        both = Stacked(signals, self.signals, place)
        m = len(signals.entries(self.of))
        if len(both.names) != 2 * m:
            raise ScenarioError(f"{self.of} has size {m}, its target {len(both.names) - m}", place)
        count, problem = 0, ""
        try:
            count = sum(int((rows.t >= both.first + delay).sum()) for rows in both)
        except NotFinite as why:
            problem = str(why)
        if not problem and not isfinite(delay):
            problem = f"nothing was received over {self.channel}"
        if not problem and not delay < both.last - both.first:
            problem = f"the run is not longer than the mean delay of {delay:.4g} s"
        if problem:
            return MetricResult(self.name, self.name, nan, both.unit, problem, parts)
        value = self._root_mean_square(both, m, delay, count)
        return MetricResult(
            self.name, self.name, value, both.unit, f"over {self.channel}, {delay:.4g} s", parts
        )

    def _root_mean_square(self, both: Stacked, m: int, delay: float, count: int) -> float:
        """The number, of `count` rows that are later than the delay, s."""
        square, first, last, error = Trapezoids(count), nan, nan, np.zeros(1)
        t, x = np.empty(0), np.empty((0, m))  # the rows of the last `delay` seconds
        for rows in both:
            t, x = np.concatenate((t, rows.t)), np.concatenate((x, rows.x[:, :m]))
            later = rows.t >= both.first + delay
            times = rows.t[later]
            if not len(times):
                continue
            shifted = np.column_stack([np.interp(times - delay, t, x[:, i]) for i in range(m)])
            error = length(shifted - rows.x[later, m:])
            square.add(error**2, times)
            first, last = (first if isfinite(first) else float(times[0])), float(times[-1])
            kept = max(0, int(np.searchsorted(t, last - delay, side="right")) - 1)
            t, x = t[kept:].copy(), x[kept:].copy()
        duration = last - first
        return sqrt(square.value / duration) if duration > 0 else float(abs(error[-1]))


def aligned_error(
    name: str, spec: AlignedSpec, arms: Mapping[str, str], place: str
) -> AlignedError:
    """The column that a table declares; `arms` by role. Raises ScenarioError."""
    roles = {arm: role for role, arm in arms.items()}
    ends = []
    for key, signal in (("of", spec.of[0]), ("target", spec.target)):
        role = roles.get(signal.partition(".")[0])
        if role is None or role in ends:
            expected = f"a signal of the arm of another role, one of {', '.join(roles)}"
            raise ScenarioError(f"found {signal!r}; expected {expected}", f"{place}.{key}")
        ends.append(role)
    return AlignedError(name, spec.of[0], spec.target, "->".join(ends))
