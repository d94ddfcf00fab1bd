"""Gateways: which way a signal takes, what is wrong with one, and the twin of it all."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.node import lockstep
from bridge.preflight import deployment
from bridge.records.node_lives import Life
from bridge.replay import replay
from bridge.zenoh.node_channel import rules_of
from cosim.base.errors import CosimError
from tests.bridge.deployments import CONFIGS, SHORT, document, named, run_twin, signal, system_of

LINK2 = str(CONFIGS / "can" / "link2.dbc")


# ---- the way of a signal ------------------------------------------------------------------------


def test_receivers_listen_on_the_bus_they_are_on():
    system = named("gateway")
    assert system.received_by("slave_control") == ("STATE_3", "XI_2")
    assert system.buses_of("slave_control") == ("right",)
    assert system.received_by("left_gateway") == ("LINK_2", "xi_slave")
    assert system.buses_of("left_gateway") == ("left", "net")
    assert system.peers_of("right_gateway") == ("slave", "slave_control", "left_gateway")


def test_a_forwarded_message_has_numbers_and_times_of_its_first_sender():
    messages = named("gateway").messages
    first, last = messages["LINK_2"], messages["XI_2"]
    assert last.node == "right_gateway" and last.bus == "right"
    assert (last.period_ns, last.offset_ns) == (first.period_ns, first.offset_ns)
    assert last.forward.origin == "LINK_2" and last.forward.of == "xi_master"
    assert messages["xi_master"].forward.sources == (2, 3)  # behind the torque
    assert last.outlet.carries == ("master_control.xi",)


def test_who_is_on_none_of_the_buses_listens_to_the_first_sender(tmp_path):
    found = document("gateway")
    for name in ("LINK_4", "STATE_3", "xi_slave", "XI_4"):
        del found["messages"][name]
    del found["messages"]["XI_2"]
    found["messages"]["xi_master"]["by"] = "left_gateway"
    found["nodes"]["slave"]["components"] += found["nodes"].pop("slave_control")["components"]
    del found["nodes"]["slave"]["drive"], found["nodes"]["right_gateway"]
    del found["buses"]["right"]
    del found["nodes"]["master_control"]["stale"]["master_control.xi_in"]
    found["messages"]["back"] = {"bus": "net", "carries": ["slave_control.xi"]}
    system = system_of(found, tmp_path)
    assert system.received_by("slave") == ("xi_master",)  # it speaks on net
    assert system.received_by("master_control") == ("STATE_1", "back")  # the only one there is


def test_arms_are_compared_where_their_nodes_are(tmp_path):
    found = document("gateway")
    found["messages"]["q_net"] = {"bus": "net", "forwards": "STATE_1", "by": "left_gateway"}
    found["messages"]["q_right"] = {
        "bus": "right", "forwards": "q_net", "by": "right_gateway", "name": "STATE_1",
    }  # fmt: skip
    apart = {"of": "master.q", "other": "slave.q", "within": "9 rad"}
    found["nodes"]["slave_control"]["apart"] = apart
    system = system_of(found, tmp_path)
    assert system.received_by("slave_control") == ("STATE_3", "XI_2", "q_right")
    assert system.buses_of("slave_control") == ("right",)


def test_loads_of_both_buses_contain_what_is_forwarded():
    system = named("gateway")
    sent = {(m.bus, m.name, m.node) for m in deployment.messages(system)}
    assert ("left", "XI_4", "left_gateway") in sent
    assert ("right", "XI_2", "right_gateway") in sent
    assert ("left", "HEARTBEAT_5", "left_gateway") in sent
    assert not [f for f in deployment.check(system) if f.severity != "note"]


def test_gateways_may_pass_on_commands_where_nodes_have_certificates():
    rules = rules_of(named("gateway"), "net")["rules"]
    nmt = [
        r["id"] for r in rules if "teleoperation/nmt" in r["key_exprs"] and "put" in r["messages"]
    ]
    assert nmt == ["left_gateway passes on", "right_gateway passes on", "operator says"]
    plain = rules_of(named("mixed"), "net")["rules"]
    assert not [r for r in plain if "passes on" in r["id"]]


def test_a_stamp_that_turns_sooner_than_a_network_is_slow_is_warned_of(tmp_path):
    found = _classic_right()
    found["messages"]["xi_master"].pop("max_age")
    (warning,) = deployment.forwarding_overruns(system_of(found, tmp_path))
    assert warning.where == "XI_2" and warning.number == pytest.approx(64 * 0.065536)
    found["messages"]["xi_master"]["max_age"] = "4 s"
    assert not deployment.forwarding_overruns(system_of(found, tmp_path))


def _classic_right():
    """The right island with 8-byte frames."""
    found = document("gateway")
    found["buses"]["right"] |= {"dbc": LINK2, "fd": False}
    m = found["messages"]
    m["XI_2"]["name"] = "XI_2"
    m["LINK_4"] |= {"carries": ["slave_control.xi"], "name": "XI_4"}
    m["tau"] = {"bus": "right", "carries": ["slave_control.tau"], "name": "TAU_4"}
    m["STATE_3"] |= {"carries": ["slave.q"], "name": "POS_3"}
    m["dq"] = {"bus": "right", "carries": ["slave.dq"], "name": "VEL_3"}
    return found


# ---- what is wrong, and where -------------------------------------------------------------------


def put(*path, value):
    def change(found):
        for part in path[:-1]:
            found = found[part]
        found[path[-1]] = value

    return change


def second_gateway(found):
    """In parallel with the left one and the right one."""
    found["nodes"]["third"] = {"number": 7}
    found["messages"]["more"] = {
        "bus": "right",
        "forwards": "LINK_2",
        "by": "third",
        "name": "LINK_2",
    }


MASTER = ("messages", "xi_master")


@pytest.mark.parametrize(
    ("change", "sentence", "place"),
    [
        (put(*MASTER, "forwards", value="LINK_9"),
         "no message 'LINK_9'; there are: LINK_2", "messages.xi_master.forwards"),
        (put(*MASTER, "forwards", value="XI_2"),
         "xi_master -> XI_2 -> xi_master is a loop", "messages.XI_2.forwards"),
        (put(*MASTER, "by", value="gate"),
         "no node 'gate'; expected one of left_gateway", "messages.xi_master.by"),
        (put(*MASTER, "by", value=""),
         "says no node that forwards LINK_2; expected one of", "messages.xi_master.by"),
        (put(*MASTER, "by", value="master_control"),
         "master_control sends LINK_2 itself; expected another node", "messages.xi_master.by"),
        (put("messages", "LINK_2", "by", value="left_gateway"),
         "says who forwards it (left_gateway), but not what", "messages.LINK_2.by"),
        (put(*MASTER, "bus", value="left"),
         "LINK_2 has been on bus left already (left -> left)", "messages.xi_master.bus"),
        (put("messages", "XI_2", "bus", value="left"),
         "xi_master has been on bus left already (left -> net -> left)", "messages.XI_2.bus"),
        (put(*MASTER, "period", value="5 ms"),
         "has a period, but comes when LINK_2 comes", "messages.xi_master.period"),
        (put(*MASTER, "carries", value=["master_control.theta_hat"]),
         "master_control.theta_hat[0] is not in LINK_2", "messages.xi_master.carries"),
        (put("messages", "XI_2", "carries", value=["master_control.tau"]),
         "master_control.tau[0] is not in xi_master", "messages.XI_2.carries"),
        (put("messages", "XI_2", "signals", value=["xi1"]),
         "1 signals for 2 values", "messages.XI_2.signals"),
        (put("nodes", "idle", value={"number": 9}),
         "has no component and forwards nothing", "nodes.idle.components"),
        (put("nodes", "master", "step", value="1 ms"),
         "has a step and components", "nodes.master.step"),
        (put("nodes", "left_gateway", "step", value="0.5 ms"),
         "0.0005 s is no multiple of the base step 0.001 s", "nodes.left_gateway.step"),
        (put("nodes", "master_control", "requires", value=["slave"]),
         "slave sends heartbeats on no bus of master_control, and they are not forwarded; expected "
         "one of master, left_gateway", "nodes.master_control.requires"),
        (second_gateway, "joins left and right, which are joined already (by left_gateway, "
         "right_gateway)", "nodes.third"),
        (put("nodes", "left_gateway", "guard", value={"tau_max": 1}),
         "no component of the node has an output 'tau'", "nodes.left_gateway.guard"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said_with_its_place(change, sentence, place, tmp_path):
    found = document("gateway")
    change(found)
    with pytest.raises(CosimError) as error:
        system_of(found, tmp_path)
    assert sentence in str(error.value)
    assert f"test.toml at {place}" in str(error.value)


# ---- the twin, and its replay -------------------------------------------------------------------


def exact(system, rows, folder):
    (folder / "again").mkdir()
    found = replay.replay(system, rows, replay.received_by_life(folder / "twin"), folder / "again")
    return (found.first, found.alone) == (None, ())


def test_the_twin_forwards_when_frames_arrive(tmp_path):
    system = named("gateway", SHORT, "deploy.latency=false")
    rows = run_twin(system, tmp_path / "twin")
    assert len(rows["left_gateway"]) == 400  # slots of 5 ms, in which no frame waits
    inlets = rows["slave_control"]["inlets"]
    xi = [i.target.port for i in system.nodes["slave_control"].inlets].index("xi_in")
    held, transit = inlets["held"][1:, xi], inlets["transit_ns"][1:, xi]
    assert np.array_equal(held, np.arange(len(held)))
    assert (transit > 100_000).all() and (transit < 400_000).all()  # two frames of CAN FD, no slot
    sent = signal(system, rows, "master_control", "master_control.xi")
    heard = signal(system, rows, "slave_control", "slave_control.xi_in")
    assert np.abs(heard[1:] - sent[:-1]).max() <= 2**-21  # an LSB of the frames is 2^-20 rad/s
    assert exact(system, rows, tmp_path)
    assert {life.node for life in rows} == set(system.nodes)


def test_replay_knows_what_every_codec_on_the_way_does(tmp_path):
    """float64 on the network, 2^-10 rad/s on classic CAN behind it."""
    found = _classic_right()
    found["nodes"]["master"]["components"].append("master_control")
    found["nodes"]["master"].pop("drive")
    found["messages"] = {
        **{name: found["messages"][name] for name in ("LINK_4", "STATE_3", "dq", "tau")},
        "xi_slave": {"bus": "net", "forwards": "LINK_4", "by": "right_gateway"},
        "xi_master": {"bus": "net", "carries": ["master_control.xi"]},
        "XI_2": {"bus": "right", "forwards": "xi_master", "by": "right_gateway"},
    }
    found |= {"sync": "slave"}
    for name in ("left_gateway", "master_control"):
        del found["nodes"][name]
    del found["buses"]["left"]
    system = system_of(found, tmp_path, SHORT)
    rows = run_twin(system, tmp_path / "twin")
    held = rows["slave_control"]["inlets"]["held"][:, -1] >= 0  # before: as the scenario begins
    heard = signal(system, rows, "slave_control", "slave_control.xi_in")[held] * 2**10
    assert len(np.unique(heard)) > 50 and np.array_equal(heard, np.round(heard))
    assert exact(system, rows, tmp_path)


def test_lock_step_has_no_gateways(tmp_path):
    with pytest.raises(CosimError, match="expected all buses to be Zenoh"):
        lockstep.is_lockstep(named("gateway", "deploy.buses.net.options.lockstep=true"))
    found = document("zenoh")
    found["buses"]["far"] = {"kind": "zenoh"}
    found["nodes"]["gate"] = {"number": 3}
    found["messages"]["on"] = {"bus": "far", "forwards": "xi_master", "by": "gate"}
    for bus in found["buses"].values():
        bus.setdefault("options", {})["lockstep"] = True
    with pytest.raises(CosimError, match="lock-step has no gateways, and gate is one"):
        lockstep.is_lockstep(system_of(found, tmp_path))


@pytest.mark.parametrize("bitrate", [1_000_000, 333_000])
def test_a_gateway_of_a_twin_forwards_a_frame_when_it_has_arrived(bitrate, tmp_path):
    """Zenoh takes no time in a twin: the far gateway hears a sample when the near one does, also
    where the bits of a bus are no whole number of ns.
    """
    system = named("gateway", "run.stop=0.5", f"deploy.buses.left.bitrate={bitrate}")
    run_twin(system, tmp_path)
    heard = replay.received_by_life(tmp_path)
    times = {}
    for node, message in (("left_gateway", "LINK_2"), ("right_gateway", "xi_master")):
        rows = heard[Life(node)]
        rows = rows[rows["message"] == system.received_by(node).index(message)]
        times[node] = rows["arrival_ns"].tolist()
    assert len(times["left_gateway"]) == 99  # the last one is on the bus at the end
    assert times["left_gateway"] == times["right_gateway"]
    assert all(t % 1_000_000 for t in times["left_gateway"])  # between the slots of all nodes
