"""Nodes in lock-step are the twin, to the bit; one that stalls or dies is named."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.deployment.system import load_system
from bridge.native import lockstep as native
from bridge.native import node as nodes
from bridge.native.bus import Bus
from bridge.native.frame import Ring
from bridge.native.message import Header
from bridge.native.safety import LifeState
from bridge.node import lockstep
from bridge.node.control import Control
from bridge.rehearsal.settings import ScheduledEvent
from bridge.replay import replay, twin
from bridge.zenoh.remote_control import COMMANDS
from cosim.base.clock import monotonic_ns
from cosim.base.errors import ScenarioError
from tests.bridge.bench import until
from tests.bridge.deployments import one_node, system_of
from tests.bridge.zenoh.rehearsed import CONFIGS, Rehearsed, collect, prepared, sockets

ARMS = ("master", "slave")
ROBOTS = tuple(f"robot{i}" for i in range(1, 7))


@given(
    period=st.integers(1, 50),
    offset=st.integers(0, 60),
    before=st.booleans(),
    deadline=st.integers(0, 2000),
    capacity=st.integers(0, 60),
)
def test_what_a_slot_needs(period: int, offset: int, before: bool, deadline: int, capacity: int):
    stream = native.StreamStruct(
        period_ns=period, offset_ns=offset, before=before, capacity=capacity
    )
    times = [s * period + offset for s in range(capacity)]
    needed = [t for t in times if t < deadline or (t == deadline and before)]
    assert native.needed(stream, deadline) == len(needed)


def test_all_buses_or_none():
    def asked(deployment: str, *settings: str) -> bool:
        return lockstep.is_lockstep(
            load_system(CONFIGS / "teleoperation.toml", deployment, settings)
        )

    said = "deploy.buses.net.options.lockstep=true"
    assert not asked("zenoh") and not asked("can") and asked("zenoh", said)
    with pytest.raises(ScenarioError, match="lockstep on net, but not on left, right"):
        asked("mixed", said)
    with pytest.raises(ScenarioError, match="at sync: lock-step does not support SYNC"):
        asked("zenoh", said, 'deploy.sync="master"')


def run(
    scenario: str,
    deployment: str,
    nodes: Sequence[str],
    folder: Path,
    events: Sequence[ScheduledEvent] = (),
    stop: float = 20.0,
    lookahead: str = "true",
) -> Rehearsed:
    changes = [
        f"deploy.buses.net.options.lookahead={lookahead}",
        f'run.stop="{stop} s"', "deploy.buses.net.options.lockstep=true",
        'deploy.buses.net.options.wait="3 s"', *sockets(nodes, folder),
    ]  # fmt: skip
    system, running = prepared(scenario, deployment, changes, folder / "run", events)
    with running:
        ended = running.run()
    return collect(system, ended, folder / "run")


def is_the_twin(found: Rehearsed, folder: Path) -> None:
    (folder / "twin").mkdir()
    twin.simulate(found.system, folder / "twin")
    expected = replay.load(folder / "twin")
    assert set(expected) == set(found.rows)
    for node, rows in expected.items():
        assert rows.tobytes() == found.rows[node].tobytes(), node


def test_a_node_without_peers_is_the_twin_and_ends_with_its_last_slot(tmp_path: Path):
    parts = ["master", "master_control", "slave", "slave_control"]
    system = system_of(one_node(parts), tmp_path, "run.stop=0.5")
    with lockstep.Lockstep(system, "all", {}, tmp_path / "journal") as node:
        Control(node.wired.struct).start(0)
        assert node.run() == nodes.FINISHED
        found, struct = node.wired.journal.rows.copy(), node.wired.struct
        assert struct.slot == struct.slots == len(found) == node.wired.engine.tick
        assert struct.life.state == LifeState.FINISHED
    twin.simulate(system, tmp_path)
    assert replay.load(tmp_path)["all"].tobytes() == found.tobytes()


class End:
    """The end of a bus of which the test is all that is outside."""

    def __init__(self) -> None:
        self.rx, tx = Ring(64), Ring(64)
        self.bus = Bus.from_rings(self.rx, tx, 0)


def test_a_node_begins_and_ends_when_nmt_says_so(tmp_path: Path):
    """It heard no NMT, and waited for ever for what `cosim tell start` had said."""
    said = "deploy.buses.net.options.lockstep=true"
    system, end = load_system(CONFIGS / "teleoperation.toml", "zenoh", [said]), End()
    nmt = system.services["net"].nmt
    assert nmt is not None

    def tell(command: int, number: int) -> None:
        end.rx.put(nmt.frame([command, number], Header(), monotonic_ns()))

    with (
        lockstep.Lockstep(system, "master", {"net": end}, tmp_path / "j") as node,  # type: ignore[dict-item]
        ThreadPoolExecutor(1) as pool,
    ):
        running, struct = pool.submit(node.run), node.wired.struct
        try:
            tell(COMMANDS["start"], system.deployment.nodes["slave"].number)
            tell(COMMANDS["arm"], 0)
            until(lambda: len(end.rx) == 0)
            assert struct.life.state != LifeState.ACTIVE
            tell(COMMANDS["start"], 0)
            until(lambda: struct.life.state == LifeState.ACTIVE)
            tell(COMMANDS["stop"], system.deployment.nodes["master"].number)
            assert running.result(20.0) == nodes.STOPPED
        finally:
            struct.quit = 1


@pytest.mark.slow
@pytest.mark.live
def test_two_nodes_are_the_twin(tmp_path: Path):
    found = run("teleoperation", "zenoh", ARMS, tmp_path)
    assert found.ended.notes == []
    is_the_twin(found, tmp_path)
    assert found.replayed.greatest == 0.0


@pytest.mark.slow
def test_six_nodes_are_the_twin(tmp_path: Path):
    found = run("network", "network", ROBOTS, tmp_path)
    assert found.ended.notes == []
    is_the_twin(found, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["kill", "freeze"])
def test_a_node_that_is_gone_is_named_and_what_was_computed_is_kept(what: str, tmp_path: Path):
    events = [ScheduledEvent(0.3, what, lambda r: getattr(r, what)("slave"))]
    events.append(ScheduledEvent(5.0, "end", lambda r: r.kill("slave")))
    # with look-ahead, the whole run can be over before the event
    found = run("teleoperation", "zenoh", ARMS, tmp_path, events, stop=200.0, lookahead="false")
    report = found.reports["master"]
    assert report["end"] == "failed"
    assert (
        "of xi_slave from node slave; nothing new for 3 s: it stalls, or is gone"
        in (report["error"])
    )
    slots = len(found.rows["master"])
    assert 0 < slots == report["slots"] < 200_000
    assert f"slot {slots} " in report["error"]
