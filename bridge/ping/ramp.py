"""Beyond which rate a path breaks: it is measured at rates that double, then in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bridge.ping.figures import PathResult

#: Highest rate, questions a second, and how often the last interval is halved (in its logarithm).
HIGHEST, HALVINGS = 20_000.0, 4
#: A path has broken when so many more questions are lost than at the first rate, a share;
LOST = 0.01
#: or when its round trips end beyond so many times the 99th percentile at the first rate.
GROWN = 2.0
#: Below this share of the wanted rate, this host is the limit.
REACHED = 0.95


@dataclass(frozen=True, slots=True)
class RampStep:
    """A rate, questions a second, the one that was `reached`, and what came of it: median and 99th
    percentile of the round trips, the median of their last quarter, s; the share `lost`; `verdict`:
    how the path broke, empty if it held.
    """

    rate: float
    reached: float
    p50: float
    p99: float
    last: float
    lost: float
    verdict: str = ""

    @property
    def text(self) -> str:
        """A line of a table."""
        said = self.verdict or ("holds" if self.sent_all else "not sent at this rate")
        return (
            f"{self.rate:9.0f}{self.reached:9.0f}{1e3 * self.p50:10.3f}{1e3 * self.p99:10.3f}"
            f"{self.lost:9.2%}  {said}"
        )

    @property
    def sent_all(self) -> bool:
        """True if this host sent at the rate."""
        return self.reached >= REACHED * self.rate


#: The heading of such lines.
HEADING = f"{'a second':>9}{'reached':>9}{'p50, ms':>10}{'p99, ms':>10}{'lost':>9}"


@dataclass(frozen=True, slots=True)
class RateLimit:
    """All `steps` by rate; `holds`: the highest rate that does, 0: not even the first one;
    `breaks`: the lowest that does not, None if all do; `why`: it does not, or higher rates were not
    tried.
    """

    steps: tuple[RampStep, ...]
    holds: float
    breaks: float | None
    why: str

    def text(self, size: int) -> str:
        """In words. `size`: payload of a question, bytes."""
        if not self.holds:
            return f"does not even hold at {self.steps[0].rate:.5g} a second: {self.why}"
        payload = f"{8e-3 * size * self.holds:.4g} kbit/s of payload each way"
        holds = f"holds at {self.holds:.5g} a second ({payload})"
        if self.breaks is None:
            return f"{holds}; {self.why}"
        return f"{holds}, not at {self.breaks:.5g}: {self.why}"


def step_of(rate: float, result: PathResult, first: RampStep | None) -> RampStep:
    """The figures of a measurement at `rate` (questions a second), judged beside the `first`."""
    rtt = result.rtt[~np.isnan(result.rtt)]
    p50, p99 = (float(x) for x in np.quantile(rtt, (0.5, 0.99)))
    last = float(np.median(rtt[-max(1, rtt.size // 4) :]))
    took = float(result.sent[-1] - result.sent[0])
    reached = (result.sent.size - 1) / took if took > 0 else rate
    lost = result.loss.share
    verdict = ""
    if lost > LOST + (first.lost if first else 0.0):
        verdict = f"{lost:.1%} lost"
    elif first and last > GROWN * first.p99:
        verdict = f"round trips grow to {1e3 * last:.3g} ms"
    return RampStep(rate, reached, p50, p99, last, lost, verdict)


def ramp(
    measured: Callable[[float], PathResult], start: float, tell: Callable[[RampStep], None]
) -> RateLimit:
    """Double the rate from `start` (questions a second) until the path breaks, and halve the
    interval between the last two rates; `tell` is called after each step.

    `measured` measures at a rate. Raises what it raises.
    """
    steps: list[RampStep] = []

    def hold(rate: float) -> bool:
        step = step_of(rate, measured(rate), steps[0] if steps else None)
        steps.append(step)
        tell(step)
        return not step.verdict

    rate = start
    while hold(rate) and steps[-1].sent_all and rate < HIGHEST:
        rate = min(2 * rate, HIGHEST)
    if steps[-1].verdict and len(steps) > 1:
        low, high = steps[-2].rate, steps[-1].rate
        for _ in range(HALVINGS):
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if hold(middle) else (low, middle)
    return limit(steps)


def limit(steps: list[RampStep]) -> RateLimit:
    """The limit that steps in any order show: lowest rate that broke, highest sent below it."""
    ordered = sorted(steps, key=lambda step: step.rate)
    broke = next((s for s in ordered if s.verdict), None)
    good = [s.rate for s in ordered if s.sent_all and (broke is None or s.rate < broke.rate)]
    last = ordered[-1]
    if broke is not None:
        why = broke.verdict
    elif not last.sent_all:
        why = f"this host cannot send more than {last.reached:.0f} a second"
    else:
        why = "higher rates were not tried"
    return RateLimit(tuple(ordered), good[-1] if good else 0.0, broke.rate if broke else None, why)
