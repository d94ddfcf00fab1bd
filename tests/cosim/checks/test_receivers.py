"""Predicted ages of queues, and the greatest skew of links, against what runs hold."""

from __future__ import annotations

from itertools import product
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cosim
from cosim.checks import Finding, merge_findings
from cosim.checks.preflight import Rule
from cosim.checks.receivers import growing_queue, skew
from cosim.links.laws import Constant, Uniform
from cosim.links.losses import Independent, Lossy
from cosim.links.semantics import Grid
from cosim.links.storage import load_table
from cosim.links.table import DrawnTable, statistics
from cosim.predict.ages import age_bound, age_range, steady_ages
from cosim.predict.system import system
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.cosim.links.queues import QUEUES

PAGE = (Path(__file__).parents[3] / "docs" / "links.md").read_text(encoding="utf-8")
TWO: dict[str, Any] = {
    "run": {"step": 0.001, "stop": 6.0},
    "components": {
        "arm": {"model": "fmus.models.planar2r", "preset": "SL91"},
        "hand": {
            "model": "fmus.models.operator",
            "period": 0.005,
            "parameters": {"k_p": 1, "k_d": 1, "q_h": [0.1, 0.1]},
        },
    },
}


def two(delay: dict[str, Any], *, period: float = 0.005, **keys: Any) -> dict[str, Any]:
    """Position and velocity of an arm, over a link each, to a hand of this period (s)."""
    links = [{"from": f"arm.{x}", "to": f"hand.{x}", "delay": delay, **keys} for x in ("q", "dq")]
    parts = TWO["components"]
    arm, hand = parts["arm"] | {"period": 0.002}, parts["hand"] | {"period": period}
    return {**TWO, "components": {"arm": arm, "hand": hand}, "links": links}


def held(document: dict[str, Any], folder: Path) -> list[Any]:
    """The rows of both links in a run, (looks,) each."""
    run = cosim.run(document, out=folder)
    return [load_table(path)[1].astype(int) for path in sorted((run.folder / "links").iterdir())]


def tripped(document: dict[str, Any], rule: Rule) -> list[Finding]:
    """The findings of a rule, equal ones once."""
    scenario = build(document, Path("test.toml"))
    return list(merge_findings(rule(system(scenario, assemble(scenario)))))


def one(document: dict[str, Any], rule: Rule) -> Finding:
    """The only finding of a rule."""
    (found,) = tripped(document, rule)
    return found


# ---- queues -------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_s", range(1, 7))
def test_queues_settle_at_the_predicted_ages(n_s: int) -> None:
    """With a constant delay the ages of a cycle are exactly those of the rows."""
    few = [q for q in QUEUES if q.depth < 9]
    for n_r, T, rule in product(range(1, 8), (0.0, 0.0012, 0.013), few):
        table = DrawnTable("x", Grid(n_s, n_r, 0.001), Constant(T), rule, 0)
        rows = table.stream().rows(300).astype(int)
        ages = (n_r * np.arange(300) - n_s * rows)[-(n_s // gcd(n_s, n_r)) :]
        assert sorted(ages.tolist()) == sorted(np.rint(steady_ages(table) / 0.001).tolist())


@given(
    rule=st.sampled_from(QUEUES), n_s=st.integers(1, 7), n_r=st.integers(1, 7),
    low=st.floats(0, 0.02), width=st.sampled_from([0.0, 0.003, 0.05]),
    hold=st.sampled_from([None, 0.02]), p=st.sampled_from([0.0, 0.2]),
)  # fmt: skip
def test_nothing_in_a_queue_is_older_than_its_bound(rule, n_s, n_r, low, width, hold, p):
    law = Uniform(low, low + width, hold)
    table = DrawnTable(
        "x", Grid(n_s, n_r, 0.001), Lossy(law, Independent(p)) if p else law, rule, 1
    )
    rows = table.stream().rows(400).astype(int)
    K, there = n_r * np.arange(400), rows >= 0
    assert ((K - n_s * rows)[there] * 0.001).max(initial=0.0) <= age_bound(table) + 1e-12
    least, oldest = age_range(table)
    newest = np.floor((K - least) / n_s)
    assert (rows <= np.maximum(newest, -1)).all()
    first = int(np.argmax(there))
    late = np.maximum(np.floor((K - oldest) / n_s), -1)
    assert not there.any() or (rows >= late)[first:].all()


@pytest.mark.parametrize(
    ("keys", "age"),
    [
        ({"depth": 100}, 0.02 + 0.0005 + 99 * 0.002),
        ({"depth": 100, "drop": "newest"}, 0.02 + 0.0005 + 100 * 0.005 - 0.002),
    ],
)
def test_a_queue_that_grows_has_the_predicted_age_in_a_run(keys, age, tmp_path):
    """500 samples a second arrive and 200 are taken: 0.6 s of age more each second."""
    document = two({"law": "constant", "delay": 0.02}, semantics="queue", **keys)
    said = one(document, growing_queue)
    assert said.severity == "warning"
    assert said.number == pytest.approx(age)
    assert "hand takes 200 samples a second" in said.reason and "500 arrive" in said.reason
    assert "age grows by 0.6 s per second" in said.reason
    assert "drop" in keys or said.reason in PAGE
    assert said.advice == 'take = "all", or depth = 1, or a period of hand of at most 0.002 s'
    for rows in held(document, tmp_path / "run"):
        grid = Grid(2, 5, 0.001)
        ages = (5 * np.arange(len(rows)) - 2 * rows) * 0.001
        assert statistics(rows, grid).age_maximum == pytest.approx(age + 0.0005)
        full = np.flatnonzero(ages > age - 0.002)[0] * 0.005
        assert full == pytest.approx((age - 0.0205) / 0.6, rel=0.1)
        assert f"until about {(age - 0.0205) / 0.6:.3g} s" in said.reason
        assert ages[-200:].mean() == pytest.approx(age)
        growing = ages[5 : int(0.8 * full / 0.005)]
        assert np.polyfit(np.arange(len(growing)) * 0.005, growing, 1)[0] == pytest.approx(
            0.6, 0.02
        )


@pytest.mark.parametrize("cure", [{"take": "all"}, {"depth": 1}, {"period": 0.002}])
def test_each_cure_is_one(cure, tmp_path):
    keys = {"depth": 100, "semantics": "queue"} | cure
    document = two({"law": "constant", "delay": 0.02}, **keys)
    assert not tripped(document, growing_queue)
    (rows, _) = held(document, tmp_path / "run")
    n_r = round(keys.get("period", 0.005) / 0.001)
    assert statistics(rows, Grid(2, n_r, 0.001)).age_maximum < 0.022


def test_a_queue_that_is_not_full_at_the_end_of_the_run(tmp_path):
    document = two({"law": "constant", "delay": 0.02}, semantics="queue", depth=10_000)
    said = one(document, growing_queue)
    assert said.number == pytest.approx(0.0205 + 0.6 * (6 - 0.0205))
    assert "not yet full" in said.reason
    (rows, _) = held(document, tmp_path / "run")
    assert (5 * (len(rows) - 1) - 2 * rows[-1]) * 0.001 == pytest.approx(said.number, abs=0.01)


def test_jitter_and_losses_are_within_the_bounds(tmp_path):
    delay = {"law": "uniform", "low": 0.0, "high": 0.02}
    document = two(
        delay, semantics="queue", depth=50, loss={"law": "independent", "p": 0.2}, channel="one"
    )
    said = one(document, growing_queue)
    assert "400 of 500 arrive" in said.reason and "0.5 s per second" in said.reason
    (rows, _) = held(document, tmp_path / "run")
    ages = (5 * np.arange(len(rows)) - 2 * rows)[-600:] * 0.001
    assert said.number == pytest.approx(ages.mean(), rel=0.05)


def test_a_full_queue_of_which_all_is_taken_may_be_stale():
    document = two({"law": "constant", "delay": 0.02}, semantics="queue", depth=2, take="all",
                   drop="newest", period=0.01)  # fmt: skip
    said = one(document, growing_queue)
    assert said.number == pytest.approx(0.02 + 0.006)
    assert "instead of 0.02 s" in said.reason


# ---- values of one time -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "keys",
    [
        {"semantics": "signal"},
        {"semantics": "last-arrival"},
        {"semantics": "newest-stamp"},
        {"semantics": "fifo"},
        {"semantics": "queue", "depth": 5},
    ],
    ids=lambda keys: keys["semantics"],
)
def test_links_without_a_channel_skew_by_no_more_than_predicted(keys, tmp_path):
    document = two({"law": "uniform", "low": 0.0, "high": 0.006}, **keys)
    said = one(document, skew)
    assert said.where == "arm->hand"
    assert "arm.dq->hand.dq, arm.q->hand.q" in said.reason
    assert keys["semantics"] not in ("signal", "newest-stamp", "fifo") or said.reason in PAGE
    a, b = held(document, tmp_path / "apart")
    both = (a >= 0) & (b >= 0)
    measured = 0.002 * np.abs(a - b)[both].max()
    assert 0 < measured <= said.number + 1e-12
    assert keys["semantics"] == "queue" or measured >= said.number / 2
    document = two({"law": "uniform", "low": 0.0, "high": 0.006}, **keys, channel="arm->hand")
    assert not tripped(document, skew)
    a, b = held(document, tmp_path / "together")
    assert (a == b).all()


@pytest.mark.parametrize(
    "delay",
    [
        {"law": "constant", "delay": 0.006},
        {"law": "segments", "delay": 0.006, "segments": [{"from": 1, "to": 2, "delay": 0.1}]},
        {"law": "frozen", "name": "lte-up"},
    ],
    ids=lambda delay: delay["law"],
)
def test_links_whose_delays_are_equal_do_not_skew(delay):
    assert not tripped(two(delay, semantics="newest-stamp"), skew)


def test_a_skew_by_losses_has_no_bound():
    loss = {"law": "independent", "p": 0.1}
    document = two({"law": "constant", "delay": 0.006}, semantics="newest-stamp", loss=loss)
    said = one(document, skew)
    assert said.number == float("inf") and "without a bound" in said.reason
