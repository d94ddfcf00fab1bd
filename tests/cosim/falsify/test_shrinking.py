"""Shrinking against made-up judges: what is left is what the failure needs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.falsify.bounds import MovingChannel
from cosim.falsify.evaluation import Problem
from cosim.falsify.judge import CandidateOutcome, Margin
from cosim.falsify.paths import Candidate, DelayPath
from cosim.falsify.search import Found
from cosim.falsify.shrinking import MANY, Shrinking
from cosim.study.axes import Drawn

H, TICKS = 0.01, 2000
CHANNELS = tuple(MovingChannel(x, (i,), (i,), 1, H, 0.3, 1.2, 0.75) for i, x in enumerate("ab"))
GRIP = Drawn("grip", ("components.a.parameters.k",), "uniform", 0.0, 10.0)


def problem(axes=()):
    return Problem(
        Path("s.toml"), {"run": {}}, CHANNELS, axes, ("r",), TICKS, H, "p", ("a", "b"), ("x",)
    )


def shrunk(fails, candidate, axes=()):
    """The result for a judge: `fails(paths (2, ticks), axes, ticks)`."""
    found = Found("segment", candidate, outcome(True, candidate), "r")
    shrinking = Shrinking(problem(axes), found, 5000)
    steps = shrinking.shrink()
    try:
        some = next(steps)
        while True:
            some = steps.send([outcome(judged(fails, c), c) for c in some])
    except StopIteration as end:
        return shrinking, end.value


def judged(fails, candidate):
    ticks = np.arange(candidate.ticks)
    return fails(np.array([path.at(ticks) for path in candidate.paths]), candidate.axes)


def outcome(failed, candidate):
    time = candidate.ticks * H / 2
    return CandidateOutcome(candidate.key, {"r": Margin(-1.0 if failed else 1.0, "rad", time)})


def noise(seed=0, edges=200):
    random = np.random.default_rng(seed)
    some = [np.sort(random.choice(TICKS, edges, replace=False)) for _ in CHANNELS]
    paths = [DelayPath.of([0, *e], random.uniform(0.3, 1.2, edges + 1)) for e in some]
    return Candidate(tuple(paths), (), TICKS)


def test_a_failure_by_one_late_sample_is_one_segment():
    def fails(T, axes):
        return T.shape[1] > 701 and bool((T[1, 690:700] > 1.0).any())

    shrinking, trial = shrunk(fails, two_late())
    assert len(trial.pieces) == 1
    ((channel, piece),) = trial.pieces
    assert channel == 1 and 0 <= piece.end - piece.begin <= 10
    assert 1.0 < piece.value <= 1.1
    assert shrinking.failing == MANY and shrinking.outcome.fails("r")


def two_late():
    late = DelayPath.of([0, 100, 600, 710, 1500], [0.75, 0.4, 1.2, 0.31, 0.9])
    return Candidate((late, late), (), TICKS)


def test_a_failure_by_two_segments_of_different_links_is_two():
    def fails(T, axes):
        long = T.shape[1] >= 1000
        return long and bool((T[0, 200:400] < 0.5).all() and (T[1, 900:1000] > 1.0).all())

    low = DelayPath.of([0, 150, 500], [0.9, 0.4, 0.8])
    high = DelayPath.of([0, 300, 850, 1200], [0.6, 0.9, 1.15, 0.5])
    shrinking, trial = shrunk(fails, Candidate((low, high), (), TICKS))
    assert [channel for channel, _ in trial.pieces] == [0, 1]
    first, second = (piece for _, piece in trial.pieces)
    assert first.begin <= 200 < 400 <= first.end and first.value < 0.5
    assert second.begin <= 900 < 1000 <= second.end and second.value > 1.0
    assert first.end - first.begin <= 300 and second.end - second.begin <= 250
    assert shrinking.failing == MANY


def test_many_random_segments_become_the_few_that_matter():
    base = noise()
    T = base.paths[0].at(np.arange(TICKS))
    far = int(np.argmax(np.abs(np.convolve(T - 0.75, np.ones(20) / 20, "valid"))))

    def fails(T, axes):
        return T.shape[1] >= far + 20 and abs(float(T[0, far : far + 20].mean()) - 0.75) > 0.2

    shrinking, trial = shrunk(fails, base)
    assert len(trial.pieces) == 1 and trial.channels == {0}
    assert shrinking.runs < 4000


def test_values_return_to_those_of_the_scenario_where_they_do_not_matter():
    def fails(T, axes):
        return (axes[0] or 0.0) > 0.4

    candidate = Candidate(noise().paths, (0.9,), TICKS)
    _, trial = shrunk(fails, candidate, (GRIP,))
    assert trial.pieces == () and trial.axes == (0.9,)


def test_the_run_is_no_longer_than_the_failure_needs_and_the_nominal_one_still_passes():
    def fails(T, axes):
        nominal = bool((T == 0.75).all())
        if T.shape[1] < 1300:
            return True  # the requirement needs some time
        return not nominal and bool((T[0, 500:600] > 1.0).any())

    late = Candidate((DelayPath.of([0, 400, 700], [0.75, 1.2, 0.75]), CHANNELS[1].base), (), TICKS)
    _, trial = shrunk(fails, late)
    assert 1300 <= trial.ticks < TICKS


def test_a_failure_that_jitter_hides_is_fragile():
    def fails(T, axes):
        return bool((T[0, 100:200] == 1.2).all())

    late = Candidate((DelayPath.of([0, 90, 300], [0.75, 1.2, 0.75]), CHANNELS[1].base), (), TICKS)
    shrinking, trial = shrunk(fails, late)
    assert len(trial.pieces) == 1
    assert shrinking.failing == 0


@pytest.mark.parametrize("seed", range(2))
def test_what_is_left_fails(seed):
    random = np.random.default_rng(seed)
    weights = random.normal(size=(2, TICKS))
    base = noise(seed, 12)
    T = np.array([p.at(np.arange(TICKS)) for p in base.paths])
    bound = 0.6 * float((weights * (T - 0.75)).sum())

    def fails(T, axes):
        missing = TICKS - T.shape[1]
        T = np.pad(T, ((0, 0), (0, missing)), constant_values=0.75)
        value = float((weights * (T - 0.75)).sum())
        return value > bound if bound > 0 else value < bound

    shrinking, trial = shrunk(fails, base)
    assert judged(fails, shrinking.trials.candidate(trial))
    assert len(trial.pieces) <= 26
