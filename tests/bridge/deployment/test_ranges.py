"""Values that cannot be are refused on every channel, and no torque is beyond the guard."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bridge.deployment import ranges
from bridge.preflight import deployment
from cosim.base.errors import ScenarioError
from tests.bridge.deployments import document, named, system_of
from tests.bridge.heard_alone import alone

SHIPPED = (
    *("can", "can-1khz", "can-classic", "can-damiao", "gateway", "mixed", "zenoh"),
    *("network", "network-can"),
)
#: Who hears xi of the other side in which message.
LINKS = [("zenoh", "master", "xi_slave"), ("mixed", "master_control", "xi_slave")]
LINKS += [("can-classic", "master_control", "XI_4")]


def xi_of(name, message, k):
    """What the sender says, (2,), rad/s."""
    return [2.0 + 0.01 * np.sin(0.1 * k), -1.0]


def column(rows, node, name):
    """A signal of the node, (rows, n)."""
    slot = node.wired.plan.plan.slots()[name]
    return rows["signals"][:, slot.start : slot.start + slot.size]


@pytest.mark.parametrize("name", SHIPPED)
def test_every_signal_of_what_is_shipped_has_a_range(name):
    system = named(name)
    assert deployment.unlimited(system) == []
    for node in system.nodes:
        for message in system.received_by(node):
            for limit in ranges.limits(system, node, system.messages[message]):
                assert -3000 < limit.low < 0 < limit.high < 3000
                assert 0 < limit.rate <= 50_000


@pytest.mark.parametrize("value", [1e6, -1e6, 31.0, -1e300])
def test_absurd_values_with_a_right_crc_are_refused(tmp_path, value):
    """Over Zenoh, where any float64 fits: refused, counted, and the true sender is heard."""
    with alone(named("zenoh"), "master", tmp_path) as node:
        for k in range(200):
            node.say("xi_slave", k, xi_of("zenoh", "xi_slave", k), 0.001)
            if k > 20:
                node.say("xi_slave", k + 1, [value, -value], -0.002)
        rows = node.run(1.0)
        counts = node.counts("xi_slave")
        assert counts.range == 179 and counts.ok == 200
        assert np.abs(column(rows, node, "master_control.xi_in")).max() < 3
        assert np.abs(column(rows, node, "master.tau")).max() < 100


def test_a_jump_within_the_range_is_refused_until_it_could_have_been(tmp_path):
    """xi from 2 to 25 rad/s takes 11.5 ms at 2000 rad/s2: the third sample is believed."""
    with alone(named("zenoh"), "master", tmp_path) as node:
        for k in range(100):
            node.say("xi_slave", k, [2.0, -1.0] if k < 50 else [25.0, -1.0], 0.001)
        node.run(0.6)
        assert node.counts("xi_slave").rate == 2 and node.counts("xi_slave").ok == 98


def test_a_torque_may_fall_to_nothing_at_once(tmp_path):
    with alone(named("can"), "master", tmp_path) as node:
        for k in range(60):
            node.say("LINK_2", k, [100.0, -100.0, 0.0, 0.0] if k < 30 else [0.0] * 4, 0.0005)
        node.run(0.3)
        assert node.counts("LINK_2").rate == 0 and node.counts("LINK_2").ok == 60


def test_a_torque_beyond_twice_what_the_drive_can_is_no_command(tmp_path):
    with alone(named("can"), "master", tmp_path) as node:
        for k in range(30):
            node.say("LINK_2", k, [100.0 if k % 3 else 241.0, 0.0, 0.0, 0.0], 0.0005)
        node.run(0.15)
        assert node.counts("LINK_2").range == 10


@settings(max_examples=15)
@given(st.lists(st.tuples(st.integers(20, 180), st.floats(allow_nan=False)), max_size=20))
def test_whatever_one_forges_torques_stay_within_the_guard(tmp_path_factory, forged):
    """`xi` of any value, each in a frame whose CRC is right."""
    found = document("zenoh")
    for node in found["nodes"].values():
        node["guard"] |= {"tau_max": "15 N.m"}
    folder = tmp_path_factory.mktemp("forged")
    with alone(system_of(found, folder), "master", folder) as node:
        for k in range(200):
            node.say("xi_slave", k, xi_of("zenoh", "xi_slave", k), 0.001)
        for k, value in forged:
            node.say("xi_slave", k, [value, value], 0.0005)
        rows = node.run(1.0)
        assert np.abs(column(rows, node, "master.tau")).max() <= 15.0
        assert node.counts("xi_slave").ok > 150


def test_a_guard_acts_where_plant_and_controller_share_a_node(tmp_path):
    found = document("zenoh")
    found["nodes"]["master"]["guard"] = {"tau_max": "3 N.m"}
    with alone(system_of(found, tmp_path), "master", tmp_path) as node:
        rows = node.run(0.5)
        assert np.abs(column(rows, node, "master.tau")).max() == 3.0
        assert node.wired.guards["master_control.tau"].trips()["torque"] > 10
        assert rows["guard"].max() > 0


def test_a_guard_that_guards_nothing_is_refused(tmp_path):
    found = document("zenoh")
    found["nodes"]["master"]["guard"]["port"] = "torque"
    with pytest.raises(ScenarioError, match="no component of the node has an output 'torque'"):
        system_of(found, tmp_path)


def test_what_has_no_range_is_told(tmp_path):
    found = document("zenoh")
    del found["signals"]
    warnings = deployment.unlimited(system_of(found, tmp_path))
    assert [w.where for w in warnings] == ["slave_control.xi", "master_control.xi"]
    assert warnings[0].rule == "no-range"


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ({"range": -1.0}, "expected more than 0"),
        ({"range": [3.0, 1.0]}, "expected the lower value first"),
        ({"range": "5 N.m"}, "rad/s"),
        ({"rate": 0.0}, "expected more than 0"),
    ],
)
def test_a_range_that_cannot_be_is_refused(tmp_path, spec, said):
    found = document("zenoh")
    found["signals"]["xi"] = spec
    system = system_of(found, tmp_path)
    with pytest.raises(ScenarioError, match=said):
        ranges.limits(system, "master", system.messages["xi_slave"])
