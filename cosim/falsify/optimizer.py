"""CMA-ES on the margin: segments of equal length on every channel, and the axes.

Source: N. Hansen, "The CMA Evolution Strategy: A Tutorial", arXiv 1604.00772; by the library `cma`.
"""

from __future__ import annotations

import importlib
from collections.abc import Generator, Sequence
from typing import Any

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.falsify.families import Space
from cosim.falsify.paths import Candidate, DelayPath
from cosim.links.laws import FloatArray

#: Length of a segment, s, and segments of a channel at most.
LENGTH, SEGMENTS = 1.0, 40
#: Candidates of a generation.
GENERATION = 32
#: The standard deviation at the start, as a share of the bounds.
START = 0.3


def optimizer(
    space: Space, turn: int, share: int
) -> Generator[list[Candidate], Sequence[float], None]:
    """Generations of candidates, in all `share`; gets their scores, numbers without a unit.

    Raises ScenarioError without the library.
    """
    try:
        cma: Any = importlib.import_module("cma")
    except ImportError:
        raise ScenarioError("needs cma: pip install 'cosim-bridge[falsify]'") from None
    n = _segments(space)
    size = n * len(space.channels) + len(space.problem.axes)
    seed = int(space.random("optimizer", turn).integers(1, 2**31))
    random = generator(seed, "falsify:optimizer")
    options = {
        "bounds": [0.0, 1.0], "popsize": GENERATION, "seed": seed,
        "randn": lambda *shape: random.standard_normal(shape),
        "verbose": -9, "verb_log": 0, "verb_disp": 0,
    }  # fmt: skip
    strategy = cma.CMAEvolutionStrategy(random.uniform(0.2, 0.8, max(2, size)), START, options)
    while share > 0 and not strategy.stop():
        points = strategy.ask()
        scores = yield [_candidate(space, np.asarray(x)) for x in points]
        strategy.tell(points, list(scores))
        share -= len(points)


def _segments(space: Space) -> int:
    seconds = space.ticks * space.problem.h
    return max(1, min(SEGMENTS, round(seconds / LENGTH))) if space.channels else 0


def _candidate(space: Space, x: FloatArray) -> Candidate:
    """The candidate at a point of the unit cube."""
    n = _segments(space)
    edges = np.arange(n) * space.ticks // max(1, n)
    paths = []
    for i, c in enumerate(space.channels):
        share = x[i * n : (i + 1) * n]
        if c.longest_loss:  # the last tenth: everything is lost
            share = np.where(share > 0.9, np.nan, share / 0.9)
        paths.append(DelayPath.of(edges, c.low + share * (c.high - c.low)))
    axes = [float(u) for u in np.clip(x[n * len(paths) :], 1e-6, 1 - 1e-6)]
    axes = axes[: len(space.problem.axes)]
    return space.candidate(paths, "segments chosen by CMA-ES", axes)
