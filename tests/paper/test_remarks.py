"""The remarks, Sec. III, IV-C and VIII: each claim on its own runs."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.paper import measure as m
from fmus.paper import oracles
from fmus.paper.operators import FORCE
from tests.paper.evidence import CLAIMS, Evidence, about

TOPICS = [
    "sec3", "sec4c", "sec8", "remark3", "remark5", "remark6", "equations", "eq33", "eq35", "matrix",
    "varying", "degree", "lemma1", "lemma2", "lemma3", "upright", "sampling",
]  # fmt: skip
NAMES = sorted(
    {n for topic in TOPICS for broken in (False, True) for n in about(topic, broken=broken)}
)


@pytest.mark.parametrize("topic", TOPICS)
def test_every_remark_has_a_claim(topic: str) -> None:
    assert about(topic, broken=False)


@pytest.mark.parametrize("name", NAMES)
def test_what_a_remark_says(evidence: Evidence, name: str) -> None:
    verdict = evidence.verdict(CLAIMS[name])
    assert verdict.passed, (verdict.measured, CLAIMS[name].expected.text, verdict.note)


def test_the_hand_of_remark_5_is_finite_and_what_it_moves_is_not(evidence: Evidence) -> None:
    """Twice the time adds nothing to the effort, and ln 2 times the drift to the position."""
    run = evidence.run("hand-one")
    half, last = m.row(run, 300.0), m.row(run, 600.0)
    effort = m.integral((run.array(FORCE) ** 2).sum(axis=1), run.t)
    assert effort[last] / effort[half] < 1.003
    moved = run.array("robot.q")[last] - run.array("robot.q")[half]
    assert moved == pytest.approx(6.0 / 32.0 * np.array([20.0, 10.0]) * np.log(2.0), rel=0.03)


def test_delays_that_are_drawn_fast_act_by_their_mean() -> None:
    """A narrow band of delays has the pole of its middle; no delay that of the law without."""
    gains = (16.0, 0.5, 1.0, 10.0, 5.0, 2.0)
    narrow = oracles.delayed_pole(*gains, (0.749, 0.751))
    wide = oracles.delayed_pole(*gains, (0.3, 1.2))
    assert wide == pytest.approx(narrow, rel=0.02)
    assert oracles.delayed_pole(*gains, (1.0, 20.0)) > wide > -0.5
