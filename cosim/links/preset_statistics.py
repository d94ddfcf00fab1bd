"""Figures of presets and frozen traces: quantiles of the delay, share and bursts of the loss."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from cosim.links.frozen_traces import frozen
from cosim.links.laws import FloatArray
from cosim.links.random_numbers import generator
from cosim.links.spec import delay_law

#: Packets drawn of a preset, and the time between two of them, s.
DRAWS, PERIOD = 1 << 15, Fraction(5, 1000)


@dataclass(frozen=True, slots=True)
class DelayFigures:
    """Delays of the packets that arrive, s; `lost`: a share; `burst`: packets in a row."""

    mean: float
    p50: float
    p95: float
    p99: float
    maximum: float
    lost: float
    burst: float


def figures_of_preset(name: str, draws: int = DRAWS) -> DelayFigures:
    """Statistics of `draws` packets at 200 per second. Raises ScenarioError if unknown."""
    law = delay_law({"law": "preset", "name": name}, Path())
    return figures(law.stream(PERIOD, generator(0, f"preset {name}")).take(draws))


def figures_of_trace(name: str) -> DelayFigures:
    """Statistics of all rows of a trace. Raises ScenarioError for an unknown name."""
    return figures(frozen(name).trace(lookup="index").delay)


def figures(delays: FloatArray) -> DelayFigures:
    """Statistics of `delays` (n,), s, not finite for lost packets; at least one arrives."""
    arrives = np.isfinite(delays)
    T, lost = delays[arrives], ~arrives
    bursts = int(np.count_nonzero(lost & ~np.concatenate(([False], lost[:-1]))))
    p50, p95, p99 = (float(x) for x in np.quantile(T, (0.5, 0.95, 0.99)))
    return DelayFigures(
        float(T.mean()), p50, p95, p99, float(T.max()), float(lost.mean()),
        float(lost.sum()) / bursts if bursts else 0.0,
    )  # fmt: skip
