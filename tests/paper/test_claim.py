"""Bands, verdicts, and how a part of the reproduction is chosen."""

from __future__ import annotations

import json
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from fmus.paper import claim as c
from fmus.paper.claims import SECTIONS, cases, select, topics
from fmus.paper.figures import FIGURES

numbers = st.floats(-1e6, 1e6)


def made(expected: c.Expected, measure: object = lambda: 0.0, **rest: object) -> c.Claim:
    """A claim of nothing in particular."""
    values = {"name": "it", "about": ("fig1",), "text": "it is", "unit": "s", "source": "here"}
    return c.Claim(**{**values, "expected": expected, "cases": (), "measure": measure, **rest})


@given(numbers, st.floats(1e-6, 1e3))
def test_a_band_has_its_ends(value: float, tolerance: float) -> None:
    band = c.absolute(value, tolerance)
    assert band.holds(value)
    assert band.holds(band.low)
    assert band.holds(band.high)
    assert not band.holds(np.nextafter(band.high, inf))
    assert not band.holds(nan)


@given(numbers, st.floats(0.001, 0.5))
def test_a_share_of_a_negative_value_is_a_band_too(value: float, share: float) -> None:
    assert c.relative(value, share).holds(value)


def test_one_sided_bands() -> None:
    assert c.at_most(1.0).holds(1.0)
    assert not c.at_most(1.0).holds(1.1)
    assert c.at_least(1.0).holds(inf)
    assert not c.at_least(1.0).holds(0.9)
    assert c.never().holds(inf)
    assert not c.never().holds(1e300)


def test_a_case_that_stopped_fails_a_claim_and_says_why() -> None:
    found = {"run": c.Stop(0.5, "arm: diverged at tick 100")}
    verdict = c.judge(made(c.at_most(1.0), cases=("run",)), found)
    assert not verdict.passed
    assert verdict.note == "run stopped: arm: diverged at tick 100"
    assert verdict.as_data()["measured"] is None


def test_a_claim_may_expect_a_stop() -> None:
    claim = made(c.within(0.1, 1.0), c.stopped, cases=("run",), stops=True)
    assert c.judge(claim, {"run": c.Stop(0.5, "diverged")}).passed


def test_an_error_while_measuring_is_a_verdict() -> None:
    def fails() -> float:
        raise ScenarioError("no signal 'x' was recorded")

    verdict = c.judge(made(c.at_most(1.0), fails), {})
    assert not verdict.passed
    assert verdict.note == "no signal 'x' was recorded"


@pytest.mark.parametrize("value", [0.0, inf, -inf, nan, 1e-300])
def test_what_is_written_is_json_that_any_reader_takes(value: float) -> None:
    verdict = c.ClaimVerdict(made(c.never()), value)
    text = json.dumps(verdict.as_data(), allow_nan=False)
    assert json.loads(text)["passed"] == (value == inf)


# ---- the claims there are -----------------------------------------------------------------------

ALL = [claim for claims in SECTIONS.values() for claim in claims]


def test_names_are_unique_and_cases_exist() -> None:
    names = [claim.name for claim in ALL]
    assert len(names) == len(set(names))
    known = set(cases(0))
    assert {case for claim in ALL for case in claim.cases} <= known
    assert {figure.case for figure in FIGURES} <= known


def test_every_case_is_of_use() -> None:
    assert select().cases == set(cases(0))


def test_every_figure_and_theorem_and_oracle_has_a_claim() -> None:
    about = {topic for claim in ALL for topic in claim.about}
    assert {f"fig{n}" for n in (1, 2, 3, *range(6, 16))} <= about
    assert {f"thm{n}" for n in range(1, 6)} <= about
    assert {f"o{n}" for n in range(1, 10)} <= about


def test_both_readings_of_the_contradictory_gain_are_shown() -> None:
    drawn = [figure.case for figure in select(["1"]).figures]
    assert drawn == ["teaching-6", "teaching-2"]


def test_a_selection_takes_what_it_needs_and_no_more() -> None:
    chosen = select(["12"])
    assert {figure.name for figure in chosen.figures} == {"fig12"}
    assert chosen.cases == {"pair-10", "pair-1"}
    assert not chosen.graphs
    assert select(["4"]).graphs
    assert not select(["4"]).cases


@pytest.mark.parametrize("given_", ["thm2", "THM2", " o5 ", "o1-damping", "robust"])
def test_selections_by_topic_or_name(given_: str) -> None:
    assert select([given_]).claims


@pytest.mark.parametrize("given_", ["16", "thm6", "fig0", "x"])
def test_what_nothing_is_about_is_refused_with_what_there_is(given_: str) -> None:
    with pytest.raises(ScenarioError, match=r"no claim is about .* fig1, .* thm1, "):
        select([given_])


def test_topics_are_in_order_of_number() -> None:
    assert {"fig4", "fig5", "fig15", "necessity", "link"} <= topics()
