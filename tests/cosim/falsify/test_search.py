"""Searches on loops whose limits are known: what is found and what is not, always the same."""

from __future__ import annotations

import sys
from functools import partial

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.base.processes import processes
from cosim.falsify.execute import falsify
from cosim.falsify.families import Space, constant, draw, segment, single, wave
from cosim.falsify.problem import document_of, problem_of
from cosim.falsify.rounds import perform
from cosim.falsify.scenario_text import failing_document, text
from cosim.falsify.search import Account, Budget, search
from cosim.falsify.words import as_data, lines
from cosim.study.store import JOURNAL
from cosim.study.workers import threads
from tests.cosim.falsify.plants import integrator

#: The delay of the last sample that counts, and the gain at which no delay is too long.
LONGEST = 8
LIMIT = (1.5 + 0.5 / (LONGEST + 1)) / (LONGEST + 1)


def scenario(folder, gain, stop=200.0, **tables):
    path = folder / "loop.toml"
    path.write_text(text({**integrator(gain * LIMIT, LONGEST, stop), **tables}))
    return path


def searched(path, folder, *families, runs=60, jobs=1, seed=0, settings=()):
    budget = Budget(runs, False, families, seed=seed)
    return falsify(path, settings, folder, partial(threads, jobs), budget)


@pytest.mark.parametrize("gain, breaks", [(1.02, True), (0.995, False)])
def test_the_greedy_adversary_breaks_the_3_2_law_just_above_it(gain, breaks, tmp_path):
    """x[k+1] = x[k] - a x[k - d[k]] (J. A. Yorke 1970, for samples)."""
    problem, _ = problem_of(scenario(tmp_path, gain, 4000.0))
    steps = search(Space(problem, 0), Budget(60, False, ("greedy",)), Account())
    found = perform(steps, problem, partial(threads, 1), tmp_path / JOURNAL)
    assert (found is not None) == breaks
    assert found is None or found.family == "greedy"


@pytest.mark.parametrize("family", ["constant", "wave", "draw", "segment", "single"])
def test_no_family_breaks_what_cannot_be_broken(family, tmp_path):
    state = searched(scenario(tmp_path, 0.97), tmp_path / "out", family)
    assert state.found is None and state.account.runs == {"nominal": 1, family: 60}
    margin, found_by, _ = state.account.least["decays"]
    assert 0 < margin.value <= 0.9 and found_by in ("nominal", family)


def test_constant_delays_are_scanned_between_the_ends_as_well(tmp_path):
    """A constant delay of 9 samples is too long from a = 2 sin(pi/(2 (2·8 + 1))) on."""
    gain = float(1.06 * 2 * np.sin(np.pi / (2 * (2 * LONGEST + 1))) / LIMIT)
    state = searched(scenario(tmp_path, gain), tmp_path / "out", "constant")
    assert state.found.family == "constant"
    data = as_data(state)
    assert data["links"] == ["one.x->one.u"] and data["requirement"] == "decays"
    assert data["segments"] and data["stop"] <= 200.0


def test_a_nominal_network_that_fails_is_told_apart(tmp_path):
    path = scenario(tmp_path, 2.2)
    state = searched(path, tmp_path / "out")
    assert state.found.family == "nominal" and state.account.total == 1
    assert as_data(state)["segments"] == []


def test_the_result_does_not_depend_on_workers(tmp_path):
    path = scenario(tmp_path, 1.8)
    found = [as_data(searched(path, tmp_path / f"{jobs}", "wave", "segment", runs=120, jobs=jobs))
             for jobs in (1, 3)]  # fmt: skip
    assert found[0] == found[1] and found[0]["found"]


def test_a_search_that_was_cut_short_continues(tmp_path):
    path = scenario(tmp_path, 1.8)
    whole = as_data(searched(path, tmp_path / "whole", "wave", "segment", runs=120))
    lines = (tmp_path / "whole" / JOURNAL).read_text().splitlines(keepends=True)
    searched(scenario(tmp_path, 1.8), tmp_path / "again", "wave", "segment", runs=120)
    (tmp_path / "again" / JOURNAL).write_text("".join(lines[:100]) + lines[100][:20])
    again = searched(path, tmp_path / "again", "wave", "segment", runs=120)
    assert as_data(again) == whole
    assert len((tmp_path / "again" / JOURNAL).read_text().splitlines()) == len(lines)


def test_a_folder_of_another_search_is_refused(tmp_path):
    path = scenario(tmp_path, 0.9)
    searched(path, tmp_path / "out", "constant", runs=2)
    with pytest.raises(ScenarioError, match="another seed"):
        searched(path, tmp_path / "out", "constant", runs=2, seed=1)
    scenario(tmp_path, 0.95)
    with pytest.raises(ScenarioError, match="another problem"):
        searched(path, tmp_path / "out", "constant", runs=2)


def test_processes_give_the_same_as_threads(tmp_path):
    path = scenario(tmp_path, 0.9)
    one = as_data(searched(path, tmp_path / "a", "single", runs=20))
    budget = Budget(20, False, ("single",))
    assert as_data(falsify(path, (), tmp_path / "b", partial(processes, 2), budget)) == one


@pytest.mark.parametrize("family", [constant, wave, draw, segment, single])
def test_candidates_follow_from_the_seed_and_keep_to_the_bounds(family, tmp_path):
    bounds = {"*": {"delay": [2.0, 7.0], "nominal": 5.0}}
    path = scenario(tmp_path, 0.9, falsify={"links": bounds})
    problem, _ = problem_of(path)
    drawn = {
        seed: [c for _, c in zip(range(70), family(Space(problem, seed), 0), strict=False)]
        for seed in (0, 1)
    }
    again = [c for _, c in zip(range(70), family(Space(problem, 0), 0), strict=False)]
    assert [c.key for c in again] == [c.key for c in drawn[0]]
    assert [c.key for c in drawn[0]] != [c.key for c in drawn[1]]
    for candidate in drawn[0]:
        (kept,) = problem.kept(candidate)
        assert kept.values.min() >= 2.0 and kept.values.max() <= 7.0
        assert candidate.says


@pytest.mark.parametrize(
    "tables, words",
    [
        ({"require": {}}, "no requirement that could be violated; expected"),
        ({"falsify": {"links": {"*": {"delay": [3.0, 2.0]}}}}, "expected the least delay, and one"),
        ({"falsify": {"links": {"*": {"delay": [3.0, 3.0]}}}}, "nothing can move"),
        ({"falsify": {"links": {"*": {"nominal": 30.0}}}}, "expected a delay from 1 s to 9 s"),
        ({"falsify": {"links": {"two": {}}}}, "no link with a law 'two'"),
        ({"falsify": {"links": {"*": {"lost": 3}}}}, "loses nothing"),
        ({"falsify": {"links": {"*": {"like": ["wifi9"]}}}}, "'wifi9'.* and no file"),
        ({"falsify": {"colour": 1}}, "colour"),
        ({"falsify": {"require": ["grows"]}}, "'grows'"),
        ({"falsify": {"families": ["zigzag"]}}, "'zigzag'"),
        ({"falsify": {"vary": {"a": {"path": "components.one.parameters.b", "uniform": [0, 1]}}}},
         r"vary.a"),
    ],
)  # fmt: skip
def test_what_cannot_be_searched_is_refused_in_a_sentence(tables, words, tmp_path):
    with pytest.raises(ScenarioError, match=words):
        searched(scenario(tmp_path, 0.9, **tables), tmp_path / "out")
    assert not (tmp_path / "out" / JOURNAL).exists()


def test_a_requirement_that_the_run_is_too_short_for_is_refused(tmp_path):
    late = {"decays": {"always": "abs(one.x) < 0.9", "within": [190.0, 300.0]}}
    with pytest.raises(ScenarioError, match=r"require\.decays is undecided in a run of 200 s"):
        searched(scenario(tmp_path, 0.5, require=late), tmp_path / "out")


@pytest.mark.slow
def test_a_run_that_kills_its_worker_is_a_failure(tmp_path):
    """And of the others that were with it none is lost."""
    path = scenario(tmp_path, 0.9)
    path.write_text(path.read_text().replace("plants:Decay", "plants:Brittle"))
    budget = Budget(20, False, ("constant",))
    problem, _ = problem_of(path)
    steps = search(Space(problem, 0), budget, account := Account())
    found = perform(steps, problem, partial(processes, 1), tmp_path / JOURNAL)
    assert found is not None and "died" in found.outcome.reason
    assert account.runs["constant"] == 20


def test_values_of_the_scenario_vary_with_the_network(tmp_path):
    vary = {"a": {"path": "components.one.parameters.a", "uniform": [0.01, 0.5]}}
    path = scenario(tmp_path, 0.5, 100.0, falsify={"vary": vary})
    state = searched(path, tmp_path / "out", "constant")
    data = as_data(state)
    assert data["found"] and data["segments"] == []
    assert data["settings"][0].startswith("components.one.parameters.a=")


def test_the_optimizer_goes_down_the_margin(tmp_path):
    """The loop x[k+1] = x[k] - a x[k - d[k]], with a gain that random segments do not break."""
    pytest.importorskip("cma")
    state = searched(scenario(tmp_path, 1.6, 60.0), tmp_path / "out", "optimizer", runs=640)
    rows = (tmp_path / "out" / JOURNAL).read_bytes()
    again = searched(scenario(tmp_path, 1.6, 60.0), tmp_path / "out", "optimizer", runs=640)
    assert as_data(again) == as_data(state)
    assert (tmp_path / "out" / JOURNAL).read_bytes() == rows  # nothing had to be run
    assert state.found is not None and state.found.family == "optimizer"
    assert state.account.runs["optimizer"] > 64


def test_a_family_without_its_library_is_left_out(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cma", None)
    state = searched(scenario(tmp_path, 0.9), tmp_path / "out", "optimizer", "single", runs=40)
    assert "pip install 'cosim-bridge[falsify]'" in state.account.notes["optimizer"]
    assert any(what == "left out" for what, _ in lines(state))


def test_a_limited_rate_is_told_and_written(tmp_path):
    path = scenario(tmp_path, 1.8, falsify={"links": {"*": {"rate": 2.0}}})
    state = searched(path, tmp_path / "out", "wave", "segment", runs=120)
    assert "(it changes by at most 2 s/s)" in as_data(state)["sentence"]
    alone = failing_document(state.problem, document_of(path, ()), state.small, tmp_path)
    law = alone["links"][0]["delay"]
    assert (law["rise"], law["fall"]) == (2.0, 2.0) and law["segments"]


def test_packets_are_told_by_when_they_are_sent(tmp_path):
    path = scenario(tmp_path, 1.8)
    path.write_text(path.read_text().replace("[[links]]", '[[links]]\nsemantics = "last-arrival"'))
    state = searched(path, tmp_path / "out", "wave", "segment", runs=120)
    assert "for what is sent from" in as_data(state)["sentence"]
