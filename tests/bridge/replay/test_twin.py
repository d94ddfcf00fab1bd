"""The twin: the cut on a simulated clock, held against the offline run and against itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bridge.native.frame import DATA
from bridge.native.journal import Journal
from bridge.native.safety import GuardBit, LifeState, Why
from bridge.recording.run_folder import write_trajectories
from bridge.replay import replay
from bridge.replay.twin import wired_nodes
from cosim.record import Run
from tests.bridge.deployments import (
    CONFIGS,
    NETWORK,
    SHORT,
    TELEOPERATION,
    document,
    named,
    offline,
    run_twin,
    signal,
    system_of,
)

Q_H = np.array([3.5, 3.0])


def as_run(system, rows, folder):
    """A run folder of rows, read back."""
    folder.mkdir()
    write_trajectories(system, rows, folder)
    return Run.open(folder)


@pytest.mark.parametrize(
    ("name", "rms", "end"), [("can", 6e-4, 1e-6), ("can-classic", 1.2e-3, 2e-3)]
)
def test_the_twin_is_near_the_offline_run_and_both_arms_reach_q_h(name, rms, end, tmp_path):
    system = named(name)
    rows = run_twin(system, tmp_path / "twin")
    run = offline(TELEOPERATION, tmp_path / "offline")
    twin = as_run(system, rows, tmp_path / "run")
    n = len(twin)
    assert n == system.plan.ticks
    for arm in ("master.q", "slave.q"):
        difference = twin.array(arm) - run.array(arm)[:n]
        assert np.sqrt(np.mean(difference**2)) < rms
        assert np.abs(twin.array(arm)[-1] - Q_H).max() < end


@pytest.mark.slow
def test_six_robots_on_one_bus_are_near_the_offline_run(tmp_path):
    system = named("network-can")
    rows = run_twin(system, tmp_path / "twin")
    run = offline(NETWORK, tmp_path / "offline")
    twin = as_run(system, rows, tmp_path / "run")
    n = min(len(run), len(twin))
    for i in range(1, 7):
        difference = twin.array(f"robot{i}.q")[:n] - run.array(f"robot{i}.q")[:n]
        assert np.sqrt(np.mean(difference**2)) < 4e-4
        assert np.abs(twin.array(f"robot{i}.q")[n - 1] - Q_H).max() < 1e-3


def test_edges_switch_in_the_nodes_as_they_switch_offline(tmp_path):
    system = named("network-can", "run.stop=3")
    rows = run_twin(system, tmp_path / "twin")
    settings = [
        "run.stop=3",
        'run.record.signals=["control1.w", "control4.w"]',
        "run.record.every=1",
    ]
    run = offline(NETWORK, tmp_path / "offline", *settings)
    for i in (1, 4):
        weights = signal(system, rows, f"robot{i}", f"control{i}.w")
        assert weights.tobytes() == run.array(f"control{i}.w")[:-1].tobytes()
        assert 0 < weights.mean() < 1


@pytest.mark.parametrize("name", ["can", "can-classic"])
def test_same_files_same_bytes(name, tmp_path):
    first = run_twin(named(name, SHORT), tmp_path / "a")
    again = run_twin(named(name, SHORT), tmp_path / "b")
    assert {n: r.tobytes() for n, r in first.items()} == {n: r.tobytes() for n, r in again.items()}


def test_a_log_of_a_bus_has_room_for_its_longest_message(tmp_path):
    """64 bytes of a frame of CAN FD, and as many as a message over a network may have."""
    for name, bus, size in (("can", "left", 64), ("zenoh", "net", DATA)):
        (folder := tmp_path / name).mkdir()
        with wired_nodes(named(name, SHORT), folder, logged=True):
            pass
        (log,) = folder.glob(f"master.*{bus}*.frames")
        assert Journal.open(log).dtype["data"].itemsize == size


def test_another_seed_draws_other_delays(tmp_path):
    first = run_twin(named("can", SHORT), tmp_path / "a")
    other = run_twin(named("can", SHORT, "run.seed=1"), tmp_path / "b")
    held = [r["slave_control"]["inlets"]["held"][:, -1].tolist() for r in (first, other)]
    assert held[0] != held[1]


@pytest.mark.parametrize("measured", ["5 ms", "1 ms"])
def test_control_at_one_kilohertz(measured, tmp_path):
    """Also where the encoders are looked at less often."""
    found = document()
    for name in ("STATE_1", "STATE_3"):
        found["messages"][name]["period"] = measured
    fast = [f"components.{c}_control.period=0.001" for c in ("master", "slave")]
    system = system_of(found, tmp_path, *fast)
    rows = run_twin(system, tmp_path / "twin")
    assert system.nodes["master_control"].h == 1e-3
    assert len(rows["master_control"]) == 60_000
    held = rows["master_control"]["inlets"]["held"][:, 0]
    every = 1 if measured == "1 ms" else 5
    assert held[-1] == 60_000 // every - 1
    for arm in ("master", "slave"):
        assert np.abs(signal(system, rows, arm, f"{arm}.q")[-1] - Q_H).max() < 1e-5


def test_without_latency_only_the_bus_takes_time(tmp_path):
    system = named("can", "run.stop=2", "deploy.latency=false")
    rows = run_twin(system, tmp_path / "twin")["slave_control"]
    i = next(i for i, x in enumerate(system.nodes["slave_control"].inlets) if x.link)
    held = rows["inlets"]["held"][1:, i]
    assert (rows["slot"][1:] - held == 1).all()  # sent at the same phase: it comes in the next slot
    assert rows["inlets"]["age_ns"][1:, i].max() == 5_000_000
    assert 0 < rows["inlets"]["transit_ns"][1:, i].max() < 1_000_000


# ---- protection ---------------------------------------------------------------------------------


def test_a_guard_limits_what_is_sent_and_the_arms_still_arrive(tmp_path):
    guard = 'deploy.nodes.master_control.guard.tau_max="5 N.m"'
    system = named("can", guard)
    rows = run_twin(system, tmp_path / "twin")
    sent = rows["master_control"]["sent"][:, :2]
    assert np.abs(sent).max() == 5.0
    assert (rows["master_control"]["guard"] & GuardBit.TORQUE).any()
    assert set(rows["master_control"]["state"].tolist()) == {LifeState.ACTIVE}
    assert np.abs(signal(system, rows, "master", "master.q")[-1] - Q_H).max() < 0.05


def test_a_guard_that_stops_lets_the_torque_down_and_takes_the_node_to_fault(tmp_path):
    changes = ['tau_max="5 N.m"', 'stops=["torque"]']
    prefix = "deploy.nodes.master_control.guard."
    system = named("can", "run.stop=2", *(prefix + change for change in changes))
    rows = run_twin(system, tmp_path / "twin")["master_control"]
    states = rows["state"].tolist()
    stopping, fault = states.index(LifeState.STOPPING), states.index(LifeState.FAULT)
    assert rows["reasons"][-1] & Why.GUARD
    assert (fault - stopping) * 5e-3 == pytest.approx(0.1, abs=0.011)
    assert (np.diff(rows["scale"]) <= 0).all()
    assert not rows["sent"][fault:, :2].any()


def slow_xi(tmp_path, period, *settings):
    """Classic CAN, where the master's xi comes seldom."""
    found = document("can-classic")
    found["messages"]["XI_2"]["period"] = period
    return system_of(found, tmp_path, *settings)


def test_an_input_that_stays_away_grows_old_and_the_controller_knows(tmp_path):
    system = slow_xi(tmp_path, "200 ms", "run.stop=10")
    rows = run_twin(system, tmp_path / "twin")
    age = signal(system, rows, "slave_control", "slave_control.age")[:, 0]
    assert 0.195 <= age.max() <= 0.2
    assert age.min() == 0.0
    estimate = signal(system, rows, "slave_control", "slave_control.theta_hat")
    still = np.flatnonzero(age[:-1] > 0.0101)
    assert still.size > 1000
    assert (estimate[still + 1] == estimate[still]).all()  # no adaptation on what is stale


def test_with_a_neighbour_that_is_hardly_heard_the_robots_stay_stable(tmp_path):
    system = slow_xi(tmp_path, "200 ms")
    rows = run_twin(system, tmp_path / "twin")
    for arm in ("master", "slave"):
        late = signal(system, rows, arm, f"{arm}.dq")[-5000:]
        assert np.abs(late).max() < 0.2
        assert set(rows[arm]["state"].tolist()) == {LifeState.ACTIVE}


def test_a_drive_whose_torque_stays_away_stops_and_brakes(tmp_path):
    found = document("can-classic")
    found["messages"]["TAU_2"]["period"] = "500 ms"
    system = system_of(found, tmp_path, "run.stop=1")
    rows = run_twin(system, tmp_path / "twin")["master"]
    assert rows["reasons"][-1] & Why.WATCHDOG
    assert rows["state"][-1] == LifeState.FAULT
    first = int(np.flatnonzero(rows["reasons"] & Why.WATCHDOG)[0])
    assert 100 <= first <= 104  # its watchdog, 100 ms


def test_a_sensor_that_stays_away_stops_the_controller(tmp_path):
    found = document("can-classic")
    found["messages"]["VEL_1"]["period"] = "500 ms"
    rows = run_twin(system_of(found, tmp_path, "run.stop=1"), tmp_path / "twin")["master_control"]
    assert rows["reasons"][-1] & Why.STALE
    assert not rows["sent"][-1][:2].any()


# ---- any cut ------------------------------------------------------------------------------------

COMPONENTS = ("master", "master_control", "slave", "slave_control")
PORTS = {"master": ("STATE_1", "q", "dq"), "slave": ("STATE_3", "q", "dq")}
PORTS |= {"master_control": ("LINK_2", "tau", "xi"), "slave_control": ("LINK_4", "tau", "xi")}


@st.composite
def deployments(draw):
    """Components in any grouping, nodes at any phase, messages on one bus or two."""
    group = [draw(st.integers(0, 3)) for _ in COMPONENTS]
    buses = draw(st.sampled_from([["a"], ["a", "b"]]))
    bus = {"dbc": str(CONFIGS / "can" / "link_fd2.dbc"), "bitrate": 500_000}
    nodes = {
        f"n{g}": {
            "components": [c for c, of in zip(COMPONENTS, group, strict=True) if of == g],
            "number": g + 1,
            "phase": draw(st.integers(0, 4999)) * 1e-6,
        }
        for g in sorted(set(group))
    }
    messages = {
        name: {
            "bus": draw(st.sampled_from(buses)),
            "carries": [f"{component}.{port}" for port in ports],
        }
        for component, (name, *ports) in PORTS.items()
    }
    return {
        "latency": draw(st.booleans()),
        "buses": {name: bus for name in buses},
        "nodes": nodes,
        "messages": messages,
    }


@settings(max_examples=8, suppress_health_check=list(HealthCheck))
@given(found=deployments(), semantics=st.sampled_from(["signal", "last-arrival", "fifo"]))
def test_any_cut_runs_and_replays_to_the_bit(found, semantics, tmp_path_factory):
    folder = tmp_path_factory.mktemp("cut")
    changes = ["run.stop=1.5", f"links.0.semantics={semantics}"]
    system = system_of(found, folder, *changes)
    rows = run_twin(system, folder / "twin")
    assert all(len(rows[name]) == node.slots for name, node in system.nodes.items())
    again = replay.replay(system, rows, replay.received_by_life(folder / "twin"), folder)
    assert again.first is None and again.greatest == 0.0 and again.alone == ()
    assert all(np.isfinite(r["signals"]).all() for r in rows.values())


def test_segments_of_a_delay_are_where_the_scenario_has_them(tmp_path):
    """Over a network that takes no time, a receiver holds what the link's table says offline."""
    segments = "[{from=0.5, to=0.55, delay=0.1}, {from=0.8, to=0.9, delay=0.4}]"
    delay = f"links.0.delay={{law='segments', delay=0.3, segments={segments}}}"
    system = named("zenoh", "run.stop=1.5", delay)
    rows = run_twin(system, tmp_path / "twin")["slave"]
    inlet = next(i for i, x in enumerate(system.nodes["slave"].inlets) if x.link)
    held = rows["inlets"]["held"][::5, inlet]
    link = next(x for x in system.plan.links if x.target.component == "slave_control")
    table = link.table.stream().rows(len(held))
    assert held.tolist() == table.tolist()
    assert sorted(set((np.arange(300) - table)[table >= 0].tolist())) == [20, 60, 80]
