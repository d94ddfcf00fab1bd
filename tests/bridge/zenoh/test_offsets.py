"""How far the clocks of two hosts are apart, and what is made of it before a start."""

from __future__ import annotations

import pytest

from bridge.deployment.system import load_system
from bridge.deployment.zenoh_keys import Names
from bridge.realtime.host_clock import HostClock
from bridge.zenoh import offsets
from bridge.zenoh.offsets import (
    Offset,
    greatest_offset,
    judge,
    measure,
    measured_origin,
    start_lead_time,
)
from cosim.base.clock import monotonic_ns, realtime_ns
from cosim.base.errors import RunError
from tests.bridge.zenoh.rehearsed import CONFIGS

OURS = HostClock("here", kept=True, error=0.001)
SAID = {"host": "there", "kept": True, "running": False, "date_ns": 0}


def offset(seconds: float, bound: float, same: bool = False, shared: bool = True) -> Offset:
    return Offset("slave", seconds, bound, same, shared, dict(SAID))


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch):
    """Clocks there are 3 s ahead; an answer takes 40, 10, 30, 20, 50 ms, half of it each way."""
    took, now = iter((40, 10, 30, 20, 50)), [1_000_000_000]

    def ask(session: object, names: Names, node: str, what: str) -> dict[str, object]:
        half = next(took) * 500_000
        now[0] += half
        said = SAID | {"date_ns": now[0] + 3_000_000_000}
        now[0] += half
        return said

    monkeypatch.setattr(offsets, "ask", ask)
    monkeypatch.setattr(offsets, "realtime_ns", lambda: now[0])


def test_the_fastest_answer_says_how_far_clocks_are_apart(answers: None):
    found = measure(None, Names("x"), "slave", OURS)  # type: ignore[arg-type]
    assert (found.seconds, found.bound) == (pytest.approx(3.0), pytest.approx(0.005))
    assert (found.same, found.shared, found.running) == (False, True, False)


@pytest.mark.parametrize(
    ("host", "kept", "same", "shared"),
    [("there", True, False, True), ("there", False, False, False), ("here", False, True, True)],
)
def test_a_clock_is_shared_on_one_host_or_where_both_are_kept(
    answers: None, monkeypatch: pytest.MonkeyPatch, host: str, kept: bool, same: bool, shared: bool
):
    monkeypatch.setitem(SAID, "host", host)
    monkeypatch.setitem(SAID, "kept", kept)
    found = measure(None, Names("x"), "slave", OURS)  # type: ignore[arg-type]
    assert (found.same, found.shared) == (same, shared)


def test_a_deployment_bears_a_period_ahead_and_max_age_behind():
    scenario = CONFIGS / "teleoperation.toml"
    assert greatest_offset(load_system(scenario, "zenoh")) == pytest.approx(0.005)
    shorter = 'deploy.messages.xi_master.max_age="4 ms"'
    assert greatest_offset(load_system(scenario, "zenoh", [shorter])) == pytest.approx(0.004)


def test_what_is_made_of_an_offset():
    d = load_system(CONFIGS / "teleoperation.toml", "zenoh").deployment
    assert judge(d, [offset(9.0, 0.0, same=True), offset(0.001, 0.001)], 0.005) == []
    (unknown,) = judge(d, [offset(0.001, 0.2)], 0.005)
    assert "not known to be within the 5 ms" in unknown
    (unkept,) = judge(d, [offset(9.0, 0.001, shared=False)], 0.005)
    assert "no time server keeps the date of both hosts (found 9e+03 ms ± 1 ms)" in unkept
    with pytest.raises(RunError, match="its clock is off by 80 ms ± 1 ms; expected at most 5 ms"):
        judge(d, [offset(0.08, 0.001)], 0.005)


def test_a_start_has_time_to_reach_the_slowest():
    assert start_lead_time([]) == 0.5
    assert start_lead_time([offset(0.0, 0.1), offset(0.0, 0.3)]) == pytest.approx(1.7)


@pytest.mark.parametrize(("bound", "running"), [(0.001, True), (0.001, False), (0.1, True)])
def test_the_origin_of_a_run_is_measured_where_it_is_known_well_enough(
    monkeypatch: pytest.MonkeyPatch, bound: float, running: bool
):
    """t = 0 was 10 s ago, by a clock that is 100 s ahead."""
    said = {"running": running, "run": 9, "origin_ns": realtime_ns() + 90_000_000_000}
    there = Offset("slave", 100.0, bound, same=False, shared=False, answer=said)
    monkeypatch.setattr(offsets, "present_nodes", lambda *_: frozenset({"slave", "operator"}))
    monkeypatch.setattr(offsets, "measure", lambda *_: there)
    system = load_system(CONFIGS / "teleoperation.toml", "zenoh")
    found = measured_origin(None, Names("x"), system)  # type: ignore[arg-type]
    if bound < 0.005 and running:
        assert found is not None and found[0] == 9
        assert abs(found[1] - (monotonic_ns() - 10_000_000_000)) < 1_000_000_000
    else:
        assert found is None
