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
from dataclasses import dataclass, field
from math import nan, sqrt
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.base.errors import RunError
from cosim.comparison.spec import Stability
from cosim.record.piecewise import PairwiseSum, extent, pieces
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
    reason, last = str(failure or ""), extent(run)[2]
    motion, speed = dict.fromkeys(how.position, 0.0), 0.0
    first: dict[str, Array] = {}
    for piece in pieces(run, (*how.position, *how.velocity)):
        t, x, v = piece.t, _largest(piece, how.position), _largest(piece, how.velocity)
        outside = np.flatnonzero(~((x <= how.position_limit) & (v <= how.velocity_limit)))
        if len(outside):
            return RunVerdict("diverged", float(t[outside[0]]), reason=reason)
        for name in how.position:
            x = stack(piece, (name,), "stable").x
            start = first.setdefault(name, x[:1].copy())
            motion[name] = float(np.abs(x - start).max(initial=motion[name]))
        speed = float(v[t >= last - how.window].max(initial=speed))
    if failure is not None:
        return RunVerdict("stopped", failure.time, reason=reason)
    return replace(_motion(run, speed, how), motion=motion)


def _motion(run: Signals, speed: float, how: Stability) -> RunVerdict:
    """The verdict on a whole run; `speed`: the largest |velocity| in its last seconds."""
    if speed < how.rest:
        return RunVerdict("at rest", speed=speed)
    r_0, r_1 = (_mean(run, how.velocity, begin) for begin in (2, 3))
    kind: Kind = "settling" if r_1 < DECAYS * r_0 else "growing" if r_1 > GROWS * r_0 else "moving"
    return RunVerdict(kind, speed=speed)


def _mean(run: Signals, names: Sequence[str], begin: int) -> float:
    """The root mean square of signals in the quarter of the run behind `begin` of them."""
    _, first, last = extent(run)

    def within(piece: Signals) -> NDArray[np.bool_]:
        with np.errstate(invalid="ignore"):
            quarter = (piece.t - first) * 4 / (last - first)
        return (quarter >= begin) & ((quarter < begin + 1) | (begin == 3))

    count = sum(int(within(piece).sum()) for piece in pieces(run, ()))
    squares = PairwiseSum(count)
    for piece in pieces(run, names):
        squares.add((stack(piece, names, "stable").x ** 2).mean(axis=1)[within(piece)])
    return sqrt(squares.value / count) if count else nan


def _largest(run: Signals, names: Sequence[str]) -> Array:
    """The largest |x_i| of each row, (n,)."""
    x = stack(run, names, "stable").x
    return np.asarray(np.abs(x).max(axis=1, initial=0.0))
