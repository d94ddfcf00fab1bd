"""A path's trace on the links of a scenario, and which controllers come to rest on it."""

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

from bridge.ping.prediction import PathTrace, directions, interval, predict, survivors
from cosim.base.errors import ScenarioError
from tests.bridge.zenoh.rehearsed import CONFIGS

PAIR = CONFIGS / "teleoperation.toml"
N = 400


def _path(there: float, back: float) -> PathTrace:
    return PathTrace(np.arange(N) * 0.005, np.full(N, there), np.full(N, back), "newest-stamp")


def test_a_scenario_is_run_with_the_delays_of_the_path() -> None:
    found = predict(PAIR, _path(0.75, 0.75), settings=["run.stop=20 s"])
    settled = next(n for n in found.numbers if n.label.startswith("sync error"))
    assert settled.ideal < settled.value < 15
    # a constant delay has no moments: only one period of a receiver, 5 ms, is not known
    assert settled.least < settled.value < settled.most < settled.least + 0.1
    assert len(found.links) == 2 and found.links[1].endswith("the way back")
    assert any("will feel" in line for line in found.findings) and not found.failures


def test_starts_differ_where_the_trace_does() -> None:
    path = _path(0.05, 0.05)
    path.there[: N // 2] = np.where(np.arange(N // 2) % 50, np.nan, 1.5)
    found = predict(PAIR, path, settings=["run.stop=12 s"])
    assert any(n.least < n.most for n in found.numbers)
    rolled = path.rolled(0.5)
    np.testing.assert_array_equal(rolled.there[N // 2 :], path.there[: N // 2])
    np.testing.assert_allclose(np.diff(rolled.sent), 0.005)
    np.testing.assert_allclose(path.rolled(0.5, 0.01).back, path.back + 0.01)


def test_the_interval_covers_99_percent_of_further_runs() -> None:
    rng = np.random.default_rng(1)
    runs = 5 + 0.1 * rng.standard_normal((20_000, 9))
    inside = 0
    for *found, further in runs:
        least, most = interval(np.array(found))
        inside += least <= further <= most
    assert inside / len(runs) == pytest.approx(0.99, abs=0.003)


def test_a_number_that_a_run_did_not_reach_has_no_upper_bound() -> None:
    assert interval(np.array([1.0, 2.0, np.inf])) == (1.0, np.inf)
    assert interval(np.array([0.01, 0.5] * 4))[0] == 0.0  # never negative, where no run was


def test_only_the_link_that_is_named_is_replaced() -> None:
    document = {"links": [{"from": "a.x", "to": "b.x"}, {"from": "b.x", "to": "a.x", "name": "n"}]}
    assert directions(document, PAIR) == {0: False, 1: True}
    assert directions(document, PAIR, "n") == {1: False}
    assert directions(document, PAIR, "a.x->b.x") == {0: False}
    with pytest.raises(ScenarioError, match=r"no link 'c'; there are: a.x->b.x, b.x->a.x"):
        directions(document, PAIR, "c")
    with pytest.raises(ScenarioError, match="no links"):
        directions({}, PAIR)


@pytest.mark.slow
def test_plain_pd_fails_on_a_path_on_which_the_paper_law_comes_to_rest(tmp_path: Path) -> None:
    path = PAIR.parent / "compare" / "bilateral.toml"
    found = {s.name: s for s in survivors(PAIR, path, _path(0.75, 0.75), tmp_path, jobs=2)}
    assert found["paper-1"].stable and found["paper-1"].text.startswith("OK")
    assert found["paper"].verdicts["tight"].startswith("no: diverged")  # lambda_M = 10
    assert "tight: no: diverged" in found["paper"].text
    assert not found["pd"].stable and found["pd"].text.startswith("FAILS")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LAN", "classic CAN at 90 %"])
def test_the_page_has_the_numbers_of_its_networks(name: str, tmp_path: Path) -> None:
    page = (CONFIGS.parent / "docs" / "network.md").read_text(encoding="utf-8")
    row = run_path(str(CONFIGS.parent / "docs" / "ping_cases.py"))["row"]
    assert row(name, tmp_path) in page.splitlines()
