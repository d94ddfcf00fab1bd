"""A closed form that only tests need, beside those of :mod:`fmus.paper.oracles`."""

from __future__ import annotations

import numpy as np


def push_manipulability(t: float, K: float, alpha: float, lambda_M: float) -> float:
    """M^t of a constant push from rest, theta known, without inertia: ‖q - q(0)‖₂ / ‖τ_h‖₂.

    q - q(0) = τ (λ_M t/α + (1 - λ_M/α)(1 - exp(-αt))/α)/K, from q = ((p + λ_M)/(p(p + α))) s.
    """
    sigma = np.linspace(0.0, t, 20001)
    rise = (1 - lambda_M / alpha) * (1 - np.exp(-alpha * sigma)) / alpha
    y = (lambda_M * sigma / alpha + rise) / K
    return float(np.sqrt(((y[1:] ** 2 + y[:-1] ** 2) / 2).mean()))
