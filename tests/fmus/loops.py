"""One arm with its controller, step by step: what the tests of the laws have in common."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cosim.base.component import Component
from fmus.arms.dynamics import inertia
from fmus.models import planar2r

SL91 = np.array(planar2r.PRESETS["SL91"]["theta"])
Values = dict[str, np.ndarray]
#: tau_ext (2,), N.m, for the time t (s), q (2,) and dq (2,).
Push = Callable[[float, np.ndarray, np.ndarray], np.ndarray]


def arrays(**values: object) -> Values:
    """Parameters by name, as arrays."""
    return {name: np.array(value, dtype=np.float64) for name, value in values.items()}


def nothing(t: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """No external torque."""
    return np.zeros(2)


def closed(
    arm: Values, law: Component, gains: Values, h: float, steps: int, push: Push = nothing
) -> Values:
    """Every signal of the arm and the law at k h, (steps, ...), before the torque acts.

    The push is sampled like the law, and held; it is in the result as `push`.
    """
    plant = planar2r.kernel()
    plant.initialize(arm)
    law.initialize(gains)
    moved = plant.initial({})
    rows: dict[str, list[np.ndarray]] = {}
    for k in range(steps):
        q, dq = np.array(moved["q"]), np.array(moved["dq"])
        u = {"q": q, "dq": dq}
        given, tau_ext = law.step(k * h, h, u), push(k * h, q, dq)
        for name, value in {**u, **given, "push": tau_ext}.items():
            rows.setdefault(name, []).append(np.array(value))
        moved = plant.step(k * h, h, {"tau": given["tau"], "tau_ext": tau_ext})
    return {name: np.array(values) for name, values in rows.items()}


def norm(x: np.ndarray, h: float) -> float:
    """L2 norm of a signal (steps, m) held over each step h (s)."""
    return float(np.sqrt(h * (x**2).sum()))


def lyapunov(run: Values, theta: np.ndarray, Gamma: np.ndarray) -> np.ndarray:
    """V = (sᵀ M(q) s + (theta_hat - theta)ᵀ Gamma⁻¹ (theta_hat - theta)) / 2, (34), each step."""
    M = np.array([inertia(theta[:3], q) for q in run["q"]])
    s, error = run["s"], run["theta_hat"] - theta
    return 0.5 * np.einsum("ki,kij,kj->k", s, M, s) + 0.5 * (error**2 / Gamma).sum(axis=1)
