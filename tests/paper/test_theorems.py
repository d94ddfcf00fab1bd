"""Theorems 1-5 hold where their hypotheses do, and fail as predicted where one is broken."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.paper import measure as m
from fmus.paper.experiments import Q_H
from tests.paper.evidence import CLAIMS, Evidence, about

THEOREMS = ["thm1", "thm2", "thm3", "thm4", "thm5"]
HOLDS = sorted({name for theorem in THEOREMS for name in about(theorem, broken=False)})
FAILS = sorted({name for theorem in THEOREMS for name in about(theorem, broken=True)})


@pytest.mark.parametrize("theorem", THEOREMS)
def test_every_theorem_is_tried_with_and_without_its_hypothesis(theorem: str) -> None:
    assert about(theorem, broken=False)
    assert about(theorem, broken=True)


@pytest.mark.parametrize("name", HOLDS)
def test_what_a_theorem_says(evidence: Evidence, name: str) -> None:
    verdict = evidence.verdict(CLAIMS[name])
    assert verdict.passed, (verdict.measured, CLAIMS[name].expected.text, verdict.note)


@pytest.mark.parametrize("name", FAILS)
def test_what_becomes_of_it_without_a_hypothesis(evidence: Evidence, name: str) -> None:
    verdict = evidence.verdict(CLAIMS[name])
    assert verdict.passed, (verdict.measured, CLAIMS[name].expected.text, verdict.note)


def test_theorem_1_needs_the_right_gravity(evidence: Evidence) -> None:
    """With 80 % of gravity compensated the same push ends where the rest of gravity balances it."""
    right, wrong = evidence.run("damped-push"), evidence.run("damped-wrong-push")
    assert m.velocity(right, "robot.q", 10.0)[0] > 0.15
    assert np.abs(m.velocity(wrong, "robot.q", 10.0)).max() < 1e-3
    assert m.growth(evidence.run("damped"), "robot.tau_h", ["robot.q"], 30.0, 60.0) > 0.45


def test_theorem_2_needs_lambda_m_and_gravity_that_is_not_adapted(evidence: Evidence) -> None:
    """A push for ever is followed for ever with lambda_M > 0, and else ends at tau/(alpha K)."""
    assert m.velocity(evidence.run("push"), "robot.q", 10.0)[0] > 0.18
    assert m.velocity(evidence.run("push-0"), "robot.q", 10.0)[0] < 1e-6
    assert np.abs(m.velocity(evidence.run("gravity-adapted"), "robot.q", 10.0)).max() < 1e-3


def test_theorem_3_needs_a_joint_spanning_tree(evidence: Evidence) -> None:
    """Without G3 the chains 1, 2, 3 and 4, 5, 6 agree each by itself; only the first is moved."""
    run = evidence.run("net-split-free")
    ends = [m.final(run, f"robot{i}.q") for i in range(1, 7)]
    for chain in (ends[:3], ends[3:]):
        assert np.ptp(np.array(chain), axis=0).max() < 1e-3
    assert m.largest_error(ends[0], ends[3]) > 1.0


def test_an_operator_on_a_leaf_moves_the_leaf_only(evidence: Evidence) -> None:
    run = evidence.run("net-leaf")
    start, end = run.array("robot3.q")[0], m.final(run, "robot3.q")
    assert m.largest_error(end, start) < 1e-9  # the root does not hear anybody
    assert m.time_to_target(run, ["robot5.q"], Q_H) == np.inf


def test_theorem_4_needs_delays_that_are_bounded(evidence: Evidence) -> None:
    heard, silent = evidence.run("net-free-delay"), evidence.run("net-silent-free")
    names = [f"robot{i}.q" for i in range(1, 7)]
    assert m.spread(heard, names)[-1] < 0.05 < m.spread(silent, names)[-1]
    assert m.peak(silent, names) < 20.0  # it does not diverge: it agrees on the wrong thing


def test_theorem_5_needs_both_links(evidence: Evidence) -> None:
    """A master that no longer hears is held by the last xi; a slave stays where it last heard."""
    unheard, deaf = evidence.run("pair-unheard"), evidence.run("pair-deaf")
    assert m.time_to_target(unheard, ["master.q"], Q_H) == np.inf
    assert m.largest_error(m.final(unheard, "master.q"), m.final(unheard, "slave.q")) < 0.01
    assert m.largest_error(m.final(deaf, "master.q"), m.final(deaf, "slave.q")) > 0.1
