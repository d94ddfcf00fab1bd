"""Impedance felt by a hand: inertia, damping and stiffness that explain torque by motion.

    f = I ddq + D dq + S (q - q_0)

The fit is least squares, for each joint over each window of a run. It finds any relation between
force and motion: if a spring and damper of the operator computed the force from the motion, the fit
finds the operator (D, S < 0, no residual) instead of the robot. :func:`is_operator` detects this.

Source: own construction (linear least squares).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from cosim.predict.facts import Array

#: A window in which the smallest direction of motion is less than this share of the largest tells
#: nothing: motions do not differ enough.
CONDITION = 1e-4
#: Rows of a window that are fitted at once.
FITTED = 1 << 17
#: Times (n,), s, and force, response and velocity (n, m) of rows, in pieces.
Moved: TypeAlias = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, slots=True)
class FeltImpedance:
    """Impedance felt at one joint from `start` to `stop`, s; SI; `residual`: share unexplained."""

    joint: int
    start: float
    stop: float
    inertia: float
    damping: float
    stiffness: float
    residual: float


def fit_impedance(
    rows: Iterable[Moved], span: tuple[float, float], window: float
) -> tuple[FeltImpedance, ...]:
    """Fit each joint over windows of `window` s that determine it.

    `span`: the times of the first and the last row, s. Of a window with more than FITTED rows every
    second one is fitted, or every third one, and so on.
    """
    starts = [span[0] + k * window for k in range(int((span[1] - span[0]) / window + 1e-9))]
    counts, step = _looked(rows, starts, window)
    every = [-(-count // FITTED) or 1 for count in counts]
    parts: list[list[tuple[Array, ...]]] = [[] for _ in starts]
    seen, found, done = [0] * len(starts), list[FeltImpedance](), 0
    for t, *values in _accelerated(rows, step):
        for k in range(done, len(starts)):
            if starts[k] > t[-1]:
                break
            inside = np.flatnonzero((t >= starts[k]) & (t <= starts[k] + window))
            kept = inside[-seen[k] % every[k] :: every[k]]
            seen[k] += len(inside)
            parts[k].append(tuple(x[kept] for x in values))
            if t[-1] > starts[k] + window:
                found += _window(parts[k], starts[k], window)
                parts[k], done = [], k + 1
    for k in range(done, len(starts)):
        found += _window(parts[k], starts[k], window)
    return tuple(found)


def _looked(
    rows: Iterable[Moved], starts: Sequence[float], window: float
) -> tuple[list[int], float | None]:
    """The number of rows in each window, and the time between rows if it is always the same."""
    counts, step, same, before = [0] * len(starts), None, True, np.empty(0)
    for t, *_ in rows:
        steps = np.diff(np.concatenate((before, t)))
        if len(steps):
            step = float(steps[0]) if step is None else step
            same = same and bool((steps == step).all())
        before = t[-1:].copy()
        counts = [
            count + int(((t >= start) & (t <= start + window)).sum())
            for count, start in zip(counts, starts, strict=True)
        ]
    return counts, step if same else None


def _accelerated(rows: Iterable[Moved], step: float | None) -> Iterator[tuple[Array, ...]]:
    """The same rows with the derivative of the velocity, as :func:`numpy.gradient` has it.

    `step`: between all rows, s, or None if it differs.
    """
    held: tuple[Array, ...] = ()  # the last two rows
    begin = 0
    for each in rows:
        t, force, response, rate = (
            np.concatenate(pair) for pair in zip(held or [x[:0] for x in each], each, strict=True)
        )
        if len(t) > 1:
            ready, begin = slice(begin, -1), 1
            ddq = _gradient(t, rate, step)
            yield t[ready], force[ready], response[ready], rate[ready], ddq[ready]
        held = t[-2:], force[-2:], response[-2:], rate[-2:]
    if held:
        t, force, response, rate = held
        yield t[-1:], force[-1:], response[-1:], rate[-1:], _gradient(t, rate, step)[-1:]


def _gradient(t: Array, x: Array, step: float | None) -> Array:
    """The derivative of `x` (n, m) at times `t` (n,), s, of second order, at the ends of first."""
    found = np.zeros_like(x)
    if len(t) < 2:
        return found
    dt = np.diff(t)[:, None] if step is None else np.full((len(t) - 1, 1), step)
    if step is None:
        a, b = dt[:-1], dt[1:]
        found[1:-1] = -b / (a * (a + b)) * x[:-2] + (b - a) / (a * b) * x[1:-1]
        found[1:-1] += a / (b * (a + b)) * x[2:]
    else:
        found[1:-1] = (x[2:] - x[:-2]) / (2.0 * step)
    found[0], found[-1] = (x[1] - x[0]) / dt[0], (x[-1] - x[-2]) / dt[-1]
    return found


def _window(
    parts: Sequence[tuple[Array, ...]], start: float, window: float
) -> Iterator[FeltImpedance]:
    """The impedance of each joint that the rows of a window determine."""
    if not parts:
        return
    force, response, rate, ddq = (np.concatenate(x) for x in zip(*parts, strict=True))
    for j in range(force.shape[1]):
        fitted = _fit(np.column_stack([ddq[:, j], rate[:, j], response[:, j]]), force[:, j])
        if fitted is not None:
            yield FeltImpedance(j, start, start + window, *fitted)


def _fit(X: Array, f: Array) -> tuple[float, float, float, float] | None:
    """(I, D, S, residual), or None where the motion does not tell them apart."""
    X, f = X - X.mean(axis=0), f - f.mean()
    scale = np.sqrt((X**2).mean(axis=0))
    size = float(np.sqrt((f**2).mean()))
    if len(f) < 12 or not (scale > 0).all() or size <= 1e-12:
        return None
    U, sigma, Vt = np.linalg.svd(X / scale, full_matrices=False)
    if sigma[-1] < CONDITION * sigma[0]:
        return None
    coefficients = (Vt.T @ ((U.T @ f) / sigma)) / scale
    residual = float(np.sqrt(((f - X @ coefficients) ** 2).mean())) / size
    inertia, damping, stiffness = (float(x) for x in coefficients)
    return inertia, damping, stiffness, residual


def is_operator(found: FeltImpedance) -> bool:
    """True if this is the operator's own spring and damper, seen from the robot."""
    return found.damping <= 0 and found.stiffness <= 0 and found.residual < 1e-3
