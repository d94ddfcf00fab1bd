"""Did a run come to rest? What the column "stable?" says.

By the recorded positions and velocities of a run: v is the largest |velocity| in its last `window`
seconds, r_1 the root of the mean square of all velocities in its last quarter, and r_0 that in the
quarter before:

=========  ========  =====================================================================
diverged   unstable  a |position| or |velocity| passed its limit: at that time
stopped    unstable  the run ended before its time without that: a component failed
at rest    stable    v < rest
settling   stable    r_1 < 0.9 r_0
moving     unstable  neither: it goes on
growing    unstable  r_1 > 1.1 r_0
=========  ========  =====================================================================

It is a verdict on one run, not a proof: a run says nothing of what comes after it, and a motion
whose time constant is longer than about twice the run counts as moving.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import nan, sqrt
from typing import Literal

import numpy as np

from cosim.base.errors import RunError
from cosim.comparison.spec import Stability
from cosim.record.signals import Array, Signals, stack

Kind = Literal["diverged", "stopped", "at rest", "settling", "moving", "growing"]

#: r_1 / r_0 below which a motion decays, and above which it grows.
DECAYS, GROWS = 0.9, 1.1


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """The outcome of a run: `time` (s) of its end if that was early, `speed` v, rad/s.

    `motion`: the largest distance (rad) of each position signal from its start, by name.
    """

    kind: Kind
    time: float = nan
    speed: float = nan
    reason: str = ""
    motion: Mapping[str, float] = field(default_factory=dict)

    @property
    def stable(self) -> bool:
        """True if it came, or comes, to rest."""
        return self.kind in ("at rest", "settling")

    @property
    def ended(self) -> bool:
        """True if there is a whole run to take numbers from."""
        return self.kind not in ("diverged", "stopped")

    @property
    def text(self) -> str:
        """The verdict as the table shows it."""
        if self.kind in ("diverged", "stopped"):
            at = "" if self.time != self.time else f" at {self.time:.2f} s"
            return f"no: {self.kind}{at}"
        if self.kind == "at rest":
            return "yes"
        answer = "yes" if self.stable else "no"
        return f"{answer}: {self.kind}, {self.speed:.2g} rad/s"


def judge(run: Signals, how: Stability, failure: RunError | None = None) -> RunVerdict:
    """The verdict on a run, which ended early if there is a `failure`."""
    reason = str(failure or "")
    t, x, v = np.asarray(run.t), _largest(run, how.position), _largest(run, how.velocity)
    outside = np.flatnonzero(~((x <= how.position_limit) & (v <= how.velocity_limit)))
    if len(outside):
        return RunVerdict("diverged", float(t[outside[0]]), reason=reason)
    if failure is not None:
        return RunVerdict("stopped", failure.time, reason=reason)
    motion = {name: _distance(run, name) for name in how.position}
    return replace(_motion(run, v, how), motion=motion)


def _distance(run: Signals, name: str) -> float:
    """The largest distance of an entry of a signal from its first value."""
    x = stack(run, (name,), "stable").x
    return float(np.abs(x - x[:1]).max(initial=0.0))


def _motion(run: Signals, v: Array, how: Stability) -> RunVerdict:
    """The verdict on a whole run; `v`: the largest |velocity| of each row, (n,)."""
    t = np.asarray(run.t)
    speed = float(v[t >= t[-1] - how.window].max())
    if speed < how.rest:
        return RunVerdict("at rest", speed=speed)
    squares = (stack(run, how.velocity, "stable").x ** 2).mean(axis=1)
    quarter = (t - t[0]) * 4 / (t[-1] - t[0])
    r_0 = sqrt(squares[(quarter >= 2) & (quarter < 3)].mean())
    r_1 = sqrt(squares[quarter >= 3].mean())
    kind: Kind = "settling" if r_1 < DECAYS * r_0 else "growing" if r_1 > GROWS * r_0 else "moving"
    return RunVerdict(kind, speed=speed)


def _largest(run: Signals, names: Sequence[str]) -> Array:
    """The largest |x_i| of each row, (n,)."""
    x = stack(run, names, "stable").x
    return np.asarray(np.abs(x).max(axis=1, initial=0.0))
