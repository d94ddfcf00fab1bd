"""Limits of joints without a stop: a motion beyond them is possible here, and not on the robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from cosim.predict.facts import Arm
from cosim.record import Run

#: Stands for no limit on one side, rad or m: JSON has no infinity.
_NONE = 1e9
#: The least and the greatest position of each joint, rad or m, by the name of its signal.
Limits = Mapping[str, Sequence[float]]


def joint_limits(arms: Mapping[str, Arm]) -> Limits:
    """The limits of all joints of `arms` at which no stop acts, rad or m."""
    return {
        f"{name}.{arm.position}[{j}]": [max(low, -_NONE), min(high, _NONE)]
        for name, arm in arms.items()
        for j, (low, high) in enumerate(zip(arm.lower, arm.upper, strict=True))
        if np.isfinite(low) or np.isfinite(high)
    }


def beyond(limits: Limits, run: Run) -> Iterator[str]:
    """A sentence for each recorded joint that left its limits (rad or m) in a run."""
    for signal, (low, high) in limits.items():
        if signal not in run.names or not len(run):
            continue
        since, most, reached = -1.0, 0.0, 0.0
        for piece in run.pieces([signal]):
            q = piece.column(signal)
            excess = np.maximum(low - q, q - high)
            outside = np.flatnonzero(excess > 0)
            if not len(outside):
                continue
            since = since if most else float(piece.t[outside[0]])
            worst = outside[np.argmax(excess[outside])]
            if excess[worst] > most:
                most, reached = float(excess[worst]), float(q[worst])
        if most:
            yield (
                f"{signal} leaves its limits {low:.4g} to {high:.4g} {run.units[signal]} at"
                f" {since:.4g} s and reaches {reached:.4g}: no stop acts (k_s = 0), a"
                " robot would not move there"
            )
