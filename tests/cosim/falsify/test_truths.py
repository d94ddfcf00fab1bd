"""Pairs of masses whose limits follow from poles: failures just above them, and none below."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cosim.falsify.families import Space
from cosim.falsify.problem import problem_of
from cosim.falsify.rounds import perform
from cosim.falsify.scenario_text import text
from cosim.falsify.search import Account, Budget, search
from cosim.study.workers import threads
from tests.cosim.falsify.plants import pair

HEAVY = {"m": 6.6, "K": 10.0, "B": 3.0, "D": 0.0}
LIGHT = {"m": 0.5, "K": 10.0, "B": 3.0, "D": 0.0}
PD = {"m": 1.0, "K": 10.0, "B": 0.0, "D": 4.0}
#: Sampling time and length of a run, s. A sample less than the limit is 1.1 % to 1.7 % below it.
TIMES = {"heavy": (0.005, 120.0), "light": (0.02, 400.0), "pd": (0.005, 120.0)}


def growth(gains: dict[str, float], delay: int, h: float) -> float:
    """The size of the largest pole of q_a - q_b for a constant delay in samples of h."""
    m, K, B, D = (gains[name] for name in ("m", "K", "B", "D"))
    a = np.zeros(2 * (delay + 1))  # acceleration by (q, dq), and by those before
    a[:2] += np.array([-K, -(B + D)]) / m
    a[2 * delay : 2 * delay + 2] += -np.array([K, D]) / m  # of the other side: of opposite sign
    F = np.zeros((2 * (delay + 1), 2 * (delay + 1)))
    F[0, :2], F[1, 1] = [1.0, h], 1.0
    F[0] += 0.5 * h * h * a
    F[1] += h * a
    F[2:, :-2] = np.eye(2 * delay)
    return float(np.abs(np.linalg.eigvals(F)).max())


def limit(gains: dict[str, float], h: float) -> int:
    """The shortest constant delay that is too long, samples of h (s)."""
    return next(d for d in range(1, 300) if growth(gains, d, h) > 1.0 + 1e-9)


def found(
    gains: dict[str, float], longest: float, times: tuple[float, float], folder: Path, family: str
) -> bool:
    """True if a family has a candidate with delays up to `longest` (s) whose motion does not
    decay; `times`: of :data:`TIMES`.
    """
    h, stop = times
    path = folder / "pair.toml"
    path.write_text(text(pair(longest, stop, h, **gains)))
    problem, _ = problem_of(path)
    steps = search(Space(problem, 0), Budget(40, False, (family,)), Account())
    return perform(steps, problem, partial(threads, 1), folder / "journal.jsonl") is not None


def test_the_heavy_pair_is_as_good_as_its_condition() -> None:
    """4 B² = (2 T)² K²: T = B/K = 0.3 s, for any delay that varies."""
    assert limit(HEAVY, 0.005) * 0.005 == pytest.approx(0.3, rel=0.035)
    assert limit(HEAVY, 0.02) * 0.02 == pytest.approx(0.3, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "gains"),
    [("heavy", HEAVY), ("light", LIGHT), ("pd", PD)],
    ids=["heavy", "light", "pd"],
)
def test_constant_delays_are_too_long_from_the_limit_on(name, gains, tmp_path) -> None:
    """A failure 5 % above the limit, rounded up to samples, and none a sample below it."""
    h, _ = TIMES[name]
    least = limit(gains, h)
    above, below = np.ceil(1.05 * least), least - 1
    assert below >= 0.98 * least
    assert found(gains, float(above * h), TIMES[name], tmp_path, "constant")
    assert not found(gains, below * h, TIMES[name], tmp_path, "constant")


@pytest.mark.slow
@pytest.mark.parametrize("family", ["wave", "draw", "greedy", "segment", "single"])
def test_no_family_breaks_the_heavy_pair_below_its_condition(family, tmp_path) -> None:
    h, _ = TIMES["heavy"]
    assert not found(HEAVY, (limit(HEAVY, h) - 1) * h, TIMES["heavy"], tmp_path, family)


@pytest.mark.slow
def test_the_greedy_adversary_breaks_the_light_pair_long_before(tmp_path) -> None:
    """Constant delays are harmless at the delays that this adversary uses, and it at B/K."""
    times = (0.02, 300.0)
    assert limit(LIGHT, 0.02) * 0.02 > 1.0
    assert found(LIGHT, 0.6, times, tmp_path, "greedy")
    assert not found(LIGHT, 0.3, times, tmp_path, "greedy")
