"""Impedance felt by a hand: inertia, damping and stiffness that explain torque by motion.

    f = I ddq + D dq + S (q - q_0)

The fit is least squares, for each joint over each window of a run. It finds any relation between
force and motion: if a spring and damper of the operator computed the force from the motion, the fit
finds the operator (D, S < 0, no residual) instead of the robot. :func:`is_operator` detects this.

Source: own construction (linear least squares).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cosim.predict.facts import Array

#: A window in which the smallest direction of motion is less than this share of the largest tells
#: nothing: motions do not differ enough.
CONDITION = 1e-4


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
    t: Array, force: Array, response: Array, rate: Array, window: float
) -> tuple[FeltImpedance, ...]:
    """Fit each joint over windows of `window` s that determine it; all arrays (n, m)."""
    found = []
    n = int((t[-1] - t[0]) / window + 1e-9)
    ddq = np.gradient(rate, t, axis=0) if len(t) > 1 else np.zeros_like(rate)
    for k in range(n):
        start = float(t[0] + k * window)
        rows = np.flatnonzero((t >= start) & (t <= start + window))
        for j in range(force.shape[1]):
            X = np.column_stack([ddq[rows, j], rate[rows, j], response[rows, j]])
            fitted = _fit(X, force[rows, j])
            if fitted is not None:
                found.append(FeltImpedance(j, start, start + window, *fitted))
    return tuple(found)


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
