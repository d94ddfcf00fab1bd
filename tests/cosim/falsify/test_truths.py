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
from tests.cosim.falsify.plants import SAMPLE, pair

HEAVY = {"m": 6.6, "K": 10.0, "B": 3.0, "D": 0.0}
LIGHT = {"m": 0.5, "K": 10.0, "B": 3.0, "D": 0.0}
PD = {"m": 1.0, "K": 10.0, "B": 0.0, "D": 4.0}


def growth(gains: dict[str, float], delay: int) -> float:
    """The size of the largest pole of q_a - q_b for a constant delay in samples."""
    m, K, B, D = (gains[name] for name in ("m", "K", "B", "D"))
    h = SAMPLE
    a = np.zeros(2 * (delay + 1))  # acceleration by (q, dq), and by those before
    a[:2] += np.array([-K, -(B + D)]) / m
    a[2 * delay : 2 * delay + 2] += -np.array([K, D]) / m  # of the other side: of opposite sign
    F = np.zeros((2 * (delay + 1), 2 * (delay + 1)))
    F[0, :2], F[1, 1] = [1.0, h], 1.0
    F[0] += 0.5 * h * h * a
    F[1] += h * a
    F[2:, :-2] = np.eye(2 * delay)
    return float(np.abs(np.linalg.eigvals(F)).max())


def limit(gains: dict[str, float]) -> float:
    """The shortest constant delay that is too long, s."""
    return SAMPLE * next(d for d in range(1, 200) if growth(gains, d) > 1.0 + 1e-9)


def found(
    gains: dict[str, float], longest: float, folder: Path, family: str, stop: float = 300.0
) -> bool:
    path = folder / "pair.toml"
    path.write_text(text(pair(float(longest), stop, **gains)))
    problem, _ = problem_of(path)
    steps = search(Space(problem, 0), Budget(40, False, (family,)), Account())
    return perform(steps, problem, partial(threads, 1), folder / "journal.jsonl") is not None


def test_the_heavy_pair_is_as_good_as_its_condition() -> None:
    """4 B² = (2 T)² K²: T = B/K = 0.3 s, for any delay that varies."""
    assert limit(HEAVY) == pytest.approx(0.3, abs=SAMPLE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains", "stop"), [(HEAVY, 300.0), (LIGHT, 900.0), (PD, 300.0)], ids=["heavy", "light", "pd"]
)
def test_constant_delays_are_too_long_from_the_limit_on(gains, stop, tmp_path) -> None:
    """Within 5 %, but for the sampling time; 7 % below, where the slowest decays within the run."""
    least = limit(gains)
    above = SAMPLE * np.ceil(1.05 * least / SAMPLE)
    assert found(gains, above, tmp_path, "constant", stop)
    assert not found(gains, 0.93 * least, tmp_path, "constant", stop)


@pytest.mark.slow
def test_the_greedy_adversary_breaks_the_light_pair_long_before(tmp_path) -> None:
    """Constant delays are harmless at the delays that this adversary uses."""
    assert limit(LIGHT) > 1.0
    assert found(LIGHT, 0.6, tmp_path, "greedy")
    assert not found(LIGHT, 0.28, tmp_path, "greedy")
