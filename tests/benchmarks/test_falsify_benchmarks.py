"""The benchmarks of falsify: the plant is the published one, and searches on it find failures."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.falsify_families import cell, failures_within, first_failures, measured
from benchmarks.falsify_transmission import COLUMNS, FORMULAS, Transmission
from benchmarks.transmission import STEP, simulate
from cosim.falsify.families import Space
from cosim.falsify.judge import CandidateOutcome, Margin, margin
from cosim.falsify.paths import Candidate, DelayPath
from cosim.falsify.search import Account, Budget, search
from cosim.study.memory import Memory

#: Time (s), speed (mph), engine's speed (rpm) and gear of the Simulink model in its passing
#: manoeuvre, as the tests of the package autotrans-py have them (github.com/cpslab-asu/
#: model-autotrans, tests/autotrans/test_data.h5); and the times (s) at which the gear changes.
TRACE = [
    (1.0, 18.32907, 2596.655, 1), (2.0, 29.70181, 2617.645, 2), (5.0, 48.89276, 2672.459, 3),
    (10.0, 66.49421, 2504.180, 4), (14.0, 74.26754, 2570.595, 4), (20.0, 98.57345, 4631.017, 3),
    (30.0, 123.04934, 4040.160, 4),
]  # fmt: skip
SHIFTS = [1.8, 4.24, 7.8, 15.08, 20.48]
#: Time (s), speed (mph) and gear of the implementation in Zélus of zlscheck (github.com/
#: ismailbennani/zlscheck, arch20), in steps of 2 ms of Euler's method.
BRAKED = [
    (5.0, 62.310, 2), (10.0, 90.437, 3), (14.0, 86.232, 4), (18.0, 76.356, 4), (26.0, 55.035, 4),
    (34.0, 35.838, 4), (38.0, 26.760, 3),
]  # fmt: skip


def test_the_transmission_is_that_of_simulink() -> None:
    """Throttle from 60 % to 40 % in 14.9 s, to 100 % in 0.1 s, and slowly back; no brake."""
    t = (np.arange(1500) + 0.5) * STEP
    throttle = np.interp(t, [0.0, 14.9, 15.0, 100.0], [60.0, 40.0, 100.0, 0.0])[:, None]
    speed, rpm, gear = simulate(throttle, np.zeros_like(throttle))
    for time, v, N, g in TRACE:
        k = round(time / STEP)
        assert speed[k, 0] == pytest.approx(v, abs=0.01)
        assert rpm[k, 0] == pytest.approx(N, abs=0.5)
        assert gear[k, 0] == g
    assert STEP * (np.flatnonzero(np.diff(gear[:, 0])) + 1) == pytest.approx(SHIFTS)


def test_brakes_act_as_in_another_implementation() -> None:
    """Full throttle for 10 s, the brake from 15 s on. Its shift logic looks at each step."""
    t = np.arange(2000) * STEP
    throttle, brake = np.where(t < 10, 100.0, 0.0)[:, None], np.where(t >= 15, 325.0, 0.0)[:, None]
    speed, rpm, gear = simulate(throttle, brake)
    for time, v, g in BRAKED:
        k = round(time / STEP)
        assert speed[k, 0] == pytest.approx(v, abs=0.1) and gear[k, 0] == g
    assert rpm[-1, 0] == 600.0


def test_runs_together_are_those_alone() -> None:
    random = np.random.default_rng(0)
    throttle, brake = random.uniform(0, 100, (500, 3)), random.uniform(0, 325, (500, 3))
    together = simulate(throttle, brake)
    for i in range(3):
        alone = simulate(throttle[:, i : i + 1], brake[:, i : i + 1])
        assert all(np.array_equal(a[:, i], b[:, 0]) for a, b in zip(together, alone, strict=True))


@pytest.mark.parametrize(
    ("formula", "family", "within"), [("AT2", "constant", 2), ("AT53", "segment", 20)]
)
def test_easy_formulas_are_falsified(formula, family, within) -> None:
    plant = Transmission(formula)
    [found] = failures_within(plant.problem, 1, plant.evaluate, (family,), 64)
    assert found is not None and 1 <= found <= within


def test_margins_are_those_of_the_formulas() -> None:
    """Full throttle without brake: 120 mph is passed within 20 s, and 4750 rpm within 10 s."""
    constants = (DelayPath.constant(100.0), DelayPath.constant(0.0))
    speed, rpm, _ = simulate(np.full((1000, 1), 100.0), np.zeros((1000, 1)))
    for formula, least in (("AT1", 120.0 - speed.max()), ("AT2", 4750.0 - rpm[:501].max())):
        plant = Transmission(formula)
        candidate = Candidate(constants, (), plant.problem.ticks)
        [outcome] = plant.evaluate([candidate])
        assert outcome.margins[formula].value == pytest.approx(least)


@pytest.mark.parametrize(
    ("throttle", "lasts", "holds"),
    [
        (DelayPath.of([0, 100, 105], [60.0, 100.0, 0.0]), 0.36, False),
        (DelayPath.constant(50.0), 2.52, True),
    ],
    ids=["foot lifted after 2.1 s", "steady"],
)
def test_a_gear_that_is_left_within_two_and_a_half_seconds_violates_at5(
    throttle, lasts, holds
) -> None:
    plant = Transmission("AT52")
    n = plant.problem.ticks
    [outcome] = plant.evaluate([Candidate((throttle, DelayPath.constant(0.0)), (), n)])
    gear = simulate(throttle.at(np.arange(n))[:, None], np.zeros((n, 1)))[2][:, 0]
    assert STEP * np.count_nonzero(gear == 2) == pytest.approx(lasts)
    assert outcome.margins["AT52"].value == (0.5 if holds else -0.5)


def test_every_formula_can_be_judged_at_the_end_of_its_run() -> None:
    for name in FORMULAS:
        plant = Transmission(name)
        problem = plant.problem
        t = STEP * np.arange(problem.ticks + 1)
        still = Memory(COLUMNS, t, np.stack([0 * t, 1000 + 0 * t, 1 + 0 * t]))
        assert margin(plant.requirement, still).value > 0


def test_the_first_failure_is_counted_without_the_nominal_run() -> None:
    """The third candidate after the nominal one fails."""
    plant = Transmission("AT1")
    seen: list[str] = []

    def evaluate(some):
        seen.extend(candidate.key for candidate in some)
        margins = [-1.0 if seen.index(c.key) == 3 else 1.0 for c in some]
        return [
            CandidateOutcome(c.key, {"AT1": Margin(x, "1", 0.0)})
            for c, x in zip(some, margins, strict=True)
        ]

    steps = search(Space(plant.problem, 0), Budget(9, families=("segment",)), Account())
    assert first_failures([steps], evaluate) == [3]


@pytest.mark.parametrize(
    ("first", "text"),
    [
        ([1, 3, None], "3 (2 of 3)"),
        ([1, None, None], "> 9 (1 of 3)"),
        ([None, None], "— (0 of 2)"),
        ([2, 4], "3 (2 of 2)"),
    ],
)
def test_a_median_counts_what_was_not_found(first, text) -> None:
    assert cell(first, 9) == text


def test_a_family_alone_breaks_the_stiff_hand() -> None:
    found = measured("(a) stiff hand: near", "segment", 2, 100)
    assert all(x is not None and x <= 100 for x in found["first"]) and found["seconds"] > 0
