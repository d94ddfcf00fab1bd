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
from math import isfinite, nan

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.comparison.spec import AlignedSpec
from cosim.measure.metric_result import MetricResult, length, root_mean_square
from cosim.record.signals import Signals, stack

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
        both = stack(signals, self.signals, place)
        m = len(signals.entries(self.of))
        if both.x.shape[1] != 2 * m:
            raise ScenarioError(f"{self.of} has size {m}, its target {both.x.shape[1] - m}", place)
        t, problem = both.t, both.problem
        if not problem and not isfinite(delay):
            problem = f"nothing was received over {self.channel}"
        if not problem and not delay < t[-1] - t[0]:
            problem = f"the run is not longer than the mean delay of {delay:.4g} s"
        if problem:
            return MetricResult(self.name, self.name, nan, both.unit, problem, parts)
        later = t[t >= t[0] + delay]
        shifted = [np.interp(later - delay, t, both.x[:, i]) for i in range(m)]
        error = length(np.column_stack(shifted) - both.x[-len(later) :, m:])
        value = root_mean_square(error, later)
        return MetricResult(
            self.name, self.name, value, both.unit, f"over {self.channel}, {delay:.4g} s", parts
        )


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
