"""Six hosts with switching graphs; lock-step over a network that loses, stalls, and ends."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from bridge.cli.diff import lines
from bridge.rehearsal.settings import ScheduledEvent
from bridge.replay.replay import load
from bridge.replay.twin import simulate
from tests.network.hosts import TCP, Case, Found, Site, bounded, exact, in_order, rehearse, settled

ROBOTS = tuple(f"robot{i}" for i in range(1, 7))
CONTROLLERS = tuple(f"control{i}" for i in range(1, 7))
#: rad; from where the run before has left them, the slow graph needs a minute less.
NEAR = ((3.1, 3.3), (3.8, 2.8), (3.3, 2.7), (3.6, 3.4), (3.9, 3.1), (3.2, 2.9))
DELAY = {"law": "uniform", "low": "10 ms", "high": "60 ms", "hold": "30 ms"}
BAD = {
    "delay": {"law": "constant", "delay": "5 ms"},
    "loss": {"law": "independent", "p": 0.02},
}
LOCK_STEP = ("deploy.latency=true", "deploy.buses.net.options.lockstep=true")
pytestmark = pytest.mark.slow


def slower(site: Site) -> Sequence[ScheduledEvent]:
    return [ScheduledEvent(-0.3, "delay", lambda r: site.network.set("*", delay=DELAY))]


def stall(site: Site) -> Sequence[ScheduledEvent]:
    return [
        ScheduledEvent(1.0, "a stall", lambda r: site.network.set("*", down=True)),
        ScheduledEvent(1.4, "its end", lambda r: site.network.set("*", **BAD)),
    ]


def death(site: Site) -> Sequence[ScheduledEvent]:
    return [ScheduledEvent(0.5, "killed", lambda r: r.kill("slave"))]


CASES = {
    "six": Case(
        20.0,
        slower,
        tuple(f"components.robot{i}.start.q=[{a}, {b}]" for i, (a, b) in enumerate(NEAR, 1))
        + tuple(f'components.{c}.parameters.age_max="1.5 s"' for c in CONTROLLERS),
        nodes=ROBOTS,
        scenario="network",
        deployment="network",
    ),
    # TCP only: what is lost is sent again, and nobody minds when it comes
    "lock-step": Case(
        100.0,
        stall,
        LOCK_STEP,
        links={"*": BAD},
        endpoints=TCP,
    ),
    "death": Case(
        200.0,
        death,
        (*LOCK_STEP, 'deploy.buses.net.options.wait="6 s"'),
        endpoints=TCP,
    ),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Found]:
    return rehearse(CASES, tmp_path_factory.mktemp("topologies"))


def test_six_hosts_with_switching_graphs(runs: dict[str, Found]):
    found = runs["six"]
    exact(found)
    settled(found, ROBOTS, within=0.15)
    bounded(found, CONTROLLERS)
    in_order(found)
    assert np.abs(found.signal("robot3.tau_h")[-200:]).max() < 0.2  # 3 N.m at first
    for i, robot in enumerate(ROBOTS, 1):
        (counts,) = found.reports[robot]["messages"].values()
        assert counts["ok"] > 3600 and counts["lost"] < 400
        assert 0.01 <= found.transit(robot)[200:].min() <= found.transit(robot).max() < 1.0
        assert found.signal(f"control{i}.age").max() < 1.0
        assert set(np.unique(found.signal(f"control{i}.w"))) == {0.0, 1.0}  # the graph did switch


def test_six_hosts_are_one_offline_run_over_their_tables(runs: dict[str, Found]):
    found = runs["six"].offline()
    assert found.verdict == "identical", lines(found)


def test_lock_step_over_a_bad_network_is_the_twin(runs: dict[str, Found], tmp_path: Path):
    found = runs["lock-step"]
    assert any("its end" in str(note) for note in found.ended.notes)
    assert (found.packets("master>slave")["delay_ns"] < 0).any()
    bounded(found)
    simulate(found.system, tmp_path)
    for node, rows in load(tmp_path).items():
        assert rows.tobytes() == found.rows[node].tobytes()


def test_who_dies_in_lock_step_is_named_and_what_was_computed_is_kept(runs: dict[str, Found]):
    found = runs["death"]
    report, rows = found.reports["master"], found.rows["master"]
    assert report["end"] == "failed"
    assert "of xi_slave from node slave; nothing new for 6 s" in report["error"]
    assert 0 < len(rows) == report["slots"] < 200_000
    assert f"slot {len(rows)} " in report["error"]
    exact(found)
