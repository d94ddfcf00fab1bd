"""Controllers on a bus log: they send the same, or the report gives the reason."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.can.log import FrameLog, write_log
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Flags, Ring, frame_dtype
from bridge.native.journal import Journal
from bridge.replay import twin
from bridge.replay.from_log import replay_log
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import named

NOW = 1_700_000_000_123_456_000  # t = 0 on the logs' clock, ns
STOP = "run.stop=1.5"


def logged_twin(system, folder, monkeypatch):
    """Rows by bus of everything that was on it in a twin."""
    journals = []

    def buses(system_, node):
        found = {}
        for number, name in enumerate(system_.buses_of(node)):
            log = Journal.create(folder / f"{node}.{name}.frames", frame_dtype(64), 1 << 15)
            journals.append((name, log))
            rings = Ring(1024), Ring(1024)
            found[name] = Bus.from_rings(*rings, number, log, kind=BusKind.MEMORY)
        return found

    monkeypatch.setattr(twin, "memory_buses", buses)
    twin.simulate(system, folder)
    logs = {}
    for name, log in journals:
        logs.setdefault(name, []).append(log.rows.copy())
        log.close()
    return {name: once(np.concatenate(parts)) for name, parts in logs.items()}


def once(rows):
    """Each frame once, when it arrived, though several have heard it."""
    rows = rows[rows["flags"] & Flags.SENT == 0]
    _, index = np.unique(rows[["t_ns", "id"]], return_index=True)
    rows = rows[np.sort(index)]
    rows["bus"] = 0
    rows["t_ns"] += NOW
    return rows[np.argsort(rows["t_ns"], kind="stable")]


def written(logs, folder, suffix="log", channels=None):
    """A file a bus."""
    paths = []
    for name, rows in logs.items():
        path = folder / f"{name}.{suffix}"
        write_log(FrameLog(rows, ((channels or {}).get(name, name),)), path)
        paths.append(path)
    return paths


CASES = {
    "can": lambda: named("can", STOP, "deploy.latency=false"),
    "can with latency": lambda: named("can", STOP),
    "can-classic": lambda: named("can-classic", STOP, "deploy.latency=false"),
}


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """A system and the rows by bus of its twin, by case; each twin runs once, rows are copies."""
    known = {}

    def call(case):
        if case not in known:
            with pytest.MonkeyPatch.context() as patch:
                known[case] = logged_twin(CASES[case](), tmp_path_factory.mktemp("twin"), patch)
        return CASES[case](), {bus: rows.copy() for bus, rows in known[case].items()}

    return call


@pytest.fixture(params=sorted(CASES))
def run(request, logged):
    """(system, rows by bus)."""
    return logged(request.param)


@pytest.fixture
def arms(logged):
    return logged("can")


def test_controllers_send_what_they_sent(run, tmp_path):
    system, logs = run
    found = replay_log(system, written(logs, tmp_path))
    assert found.exact, found
    assert abs(found.start_ns - NOW) < 1_000_000
    assert [n.node for n in found.nodes] == ["master_control", "slave_control"]
    assert found.remarks == ()
    for node in found.nodes:
        messages = [m for m in system.messages.values() if m.node == node.node]
        assert node.slots == 300 and node.first == 0 and node.unheard == 0
        assert node.compared == 300 * len(messages)
        assert {v.name.partition("[")[0] for v in node.values} == {
            f"{node.node}.tau", f"{node.node}.xi"
        }  # fmt: skip


@pytest.mark.parametrize("suffix", ["log", "blf", "asc"])
def test_logs_of_other_tools_are_read(arms, suffix, tmp_path):
    system, logs = arms
    found = replay_log(system, written(logs, tmp_path, suffix))
    assert [n.compared for n in found.nodes] == [300, 300]
    assert all(v.rms < 1e-2 for n in found.nodes for v in n.values)


def test_channels_of_the_deployment_name_buses_too_also_in_one_file(arms, tmp_path):
    system, logs = arms
    left, right = logs["left"].copy(), logs["right"].copy()
    right["bus"] = 1
    both = np.concatenate([left, right])
    both = both[np.argsort(both["t_ns"], kind="stable")]
    path = tmp_path / "everything.log"
    write_log(FrameLog(both, ("vcan0", "vcan1")), path)
    assert replay_log(system, path).exact


def test_a_torque_that_was_altered_is_found(arms, tmp_path):
    """Not by its bytes (the CRC would tell), but by a sender that computes something else."""
    system, logs = arms
    carried = system.messages["LINK_4"]
    codec = carried.encoding
    rows = logs["right"]
    index = np.flatnonzero(rows["id"] == codec.message.id)[200]
    data = rows["data"][index][: codec.layout.length].tobytes()
    _, values, header = codec.decode(data)
    values[1] += 0.25
    again = codec.encode(values, header.status, header.t_us, header.counter)
    rows["data"][index][: len(again)] = np.frombuffer(again, np.uint8)
    slave = replay_log(system, written(logs, tmp_path)).nodes[1]
    assert not slave.exact
    value = next(v for v in slave.values if v.name == "slave_control.tau[1]")
    assert (value.differ, value.first, value.t) == (1, 200, 1.0)
    assert value.largest == pytest.approx(0.25)


def test_frames_the_log_has_lost_are_said_and_bridged(arms, tmp_path):
    system, logs = arms
    ids = {n: m.encoding.message.id for n, m in system.messages.items()}
    rows = logs["left"]
    gone = np.flatnonzero(rows["id"] == ids["LINK_2"])[100:110]
    logs["left"] = np.delete(rows, gone)
    master, slave = replay_log(system, written(logs, tmp_path)).nodes
    assert (master.slots, master.compared, master.unheard) == (300, 290, 10)
    assert master.exact
    assert not slave.exact  # it had heard them
    assert 100 <= min(v.first for v in slave.values if v.differ) <= 101


def test_a_log_that_begins_late_says_so_and_comes_near(arms, tmp_path):
    system, logs = arms
    late = {n: r[r["t_ns"] > NOW + 500_000_000] for n, r in logs.items()}
    found = replay_log(system, written(late, tmp_path))
    assert {n.first for n in found.nodes} <= {100, 101}
    assert not found.exact
    assert sum("what it knew then is not in the log" in text for text in found.remarks) == 2
    assert abs(found.start_ns - NOW) < 1_000_000


def test_one_bus_is_enough_for_the_controller_that_needs_no_other(arms, tmp_path):
    system, logs = arms
    del logs["right"]
    found = replay_log(system, written(logs, tmp_path))
    assert [n.node for n in found.nodes] == ["master_control"]
    assert found.remarks[0] == "right: not logged"


def test_frames_before_the_start_do_not_hurt(arms, tmp_path):
    """Heartbeats, and previews of nodes that do not run yet."""
    system, logs = arms
    rows = logs["left"]
    beats = rows[(rows["id"] >= 0x701) & (rows["id"] <= 0x704)][:3].copy()
    beats["t_ns"] = NOW - np.array([300, 200, 100]) * 1_000_000
    logs["left"] = np.concatenate([beats, rows])
    assert replay_log(system, written(logs, tmp_path)).exact


def test_when_it_began_may_be_said(arms, tmp_path):
    system, logs = arms
    assert replay_log(system, written(logs, tmp_path), NOW).exact


# ---- what is no log of this ---------------------------------------------------------------------


def test_another_bus_is_refused(arms, tmp_path):
    system, logs = arms
    paths = written(logs, tmp_path, channels={"left": "can7", "right": "can8"})
    odd = [path.rename(path.with_name(f"x{path.name}")) for path in paths]
    with pytest.raises(ScenarioError, match=r"bus 'can7' is none .* has left \(vcan0\), right"):
        replay_log(system, odd)


def test_a_log_without_their_frames_is_refused(arms, tmp_path):
    system, logs = arms
    for name, rows in logs.items():
        logs[name] = rows[rows["id"] > 0x700]
    with pytest.raises(ScenarioError, match="no message with a time stamp in the log"):
        replay_log(system, written(logs, tmp_path))


def test_nodes_with_a_plant_are_no_controllers(tmp_path, monkeypatch):
    system = named("network-can", "run.stop=1")
    logs = logged_twin(system, tmp_path, monkeypatch)
    with pytest.raises(ScenarioError, match="no frame of a controller"):
        replay_log(system, written(logs, tmp_path))
