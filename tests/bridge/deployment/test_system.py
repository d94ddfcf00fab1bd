"""A scenario with a deployment: codecs, receivers of messages, and errors for what does not fit."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bridge.can import dbc
from bridge.deployment.system import load_system
from bridge.wiring.wiring import row_dtype
from cosim.base.errors import CosimError, ScenarioError
from tests.bridge.deployments import SHORT, TELEOPERATION, document, named, system_of


def test_what_follows_in_a_row_is_aligned():
    for plan in named("can").nodes.values():
        dtype = row_dtype(plan)
        fields = dtype.fields
        assert fields["sent"][1] % 8 == fields["signals"][1] % 8 == dtype.itemsize % 8 == 0


# ---- who hears what -----------------------------------------------------------------------------


def test_nodes_are_on_the_buses_they_send_or_hear_on():
    system = named("can")
    assert system.buses_of("master") == ("left",)
    assert system.buses_of("slave_control") == ("left", "right")
    assert system.received_by("master") == ("LINK_2",)
    assert system.received_by("slave_control") == ("LINK_2", "STATE_3")
    assert system.peers_of("master") == ("slave", "master_control", "slave_control")[1:]


def test_nodes_listen_to_data_and_to_services():
    heard = {one.name: one.accept.id for one in named("can").subscriptions("master")}
    assert heard["LINK_2"] == 0x3A2
    assert heard["NMT"] == 0 and heard["ESTOP"] == 1 and heard["SYNC"] == 0x80
    assert {name for name in heard if name.startswith("HEARTBEAT")} == {
        f"HEARTBEAT_{n}" for n in (1, 2, 3, 4)
    }


def test_signals_are_called_by_port_and_number():
    system = named("can-classic")
    names = {n: [s.name for s in m.encoding.signals] for n, m in system.messages.items()}
    assert names["POS_1"] == ["q1", "q2"]
    assert names["TAU_4"] == ["tau1", "tau2"]


def test_a_message_knows_period_phase_and_age(tmp_path):
    found = document("can-classic")
    found["messages"]["POS_1"]["max_age"] = "3 ms"
    messages = system_of(found, tmp_path).messages
    assert messages["POS_1"].period_ns == 5_000_000
    assert messages["POS_1"].offset_ns == 0
    assert messages["POS_1"].max_age_ns == 3_000_000
    assert messages["XI_2"].offset_ns == 1_000_000


def test_another_name_and_other_signals_may_be_said(tmp_path):
    found = document()
    found["messages"]["here"] = found["messages"].pop("STATE_1") | {
        "name": "STATE_5",
        "signals": ["dq1", "dq2", "q1", "q2"],
        "carries": ["master.dq", "master.q"],
    }
    carried = system_of(found, tmp_path).messages["here"]
    assert carried.encoding.message.id == 0x4A5
    assert [s.name for s in carried.encoding.signals] == ["dq1", "dq2", "q1", "q2"]


def with_units(folder, unit):
    """The messages on buses whose DBC file has joint positions in another unit."""
    found = document()
    for name, bus in found["buses"].items():
        text = Path(bus["dbc"]).read_text(encoding="cp1252")
        changed = re.sub(r'( SG_ q\d .*)"rad"', rf'\1"{unit}"', text)
        assert changed != text
        bus["dbc"] = str(folder / f"{name}.dbc")
        Path(bus["dbc"]).write_text(changed, encoding="cp1252")
    return system_of(found, folder).messages


@pytest.mark.parametrize(("unit", "factor"), [("deg", 180 / np.pi), ("mrad", 1e3), ("", 1.0)])
def test_values_are_in_the_units_of_the_dbc_file_on_the_bus(tmp_path, unit, factor):
    codec = with_units(tmp_path, unit)["STATE_1"].encoding
    data = codec.encode([0.5, -0.25, 1.0, 2.0])
    seen = dbc.CantoolsMessage(codec.layout).decode(data, scaling=True)
    assert [seen[s] for s in ("q1", "q2")] == pytest.approx([0.5 * factor, -0.25 * factor], 1e-4)
    assert [seen[s] for s in ("dq1", "dq2")] == pytest.approx([1.0, 2.0], 1e-4)


@pytest.mark.parametrize(
    ("unit", "why"), [("m", r"\[m\] cannot feed \[rad\]"), ("degree", "unknown unit 'degree'")]
)
def test_a_unit_of_a_dbc_file_that_does_not_fit_is_refused(tmp_path, unit, why):
    says = rf"STATE_1: signal q1 is in \[{unit}\], but master.q\[0\] is in \[rad\]: {why}.*; expect"
    with pytest.raises(ScenarioError, match=says):
        with_units(tmp_path, unit)


def test_settings_reach_scenario_and_deployment():
    system = named("can", SHORT, 'deploy.nodes.master_control.phase="2 ms"')
    assert system.plan.ticks == 2000
    assert system.messages["LINK_2"].offset_ns == 2_000_000


def test_the_network_shares_one_bus():
    system = named("network-can")
    for i in range(1, 7):
        assert system.received_by(f"robot{i}") == (f"XI_{(i - 2) % 6 + 1}",)
        assert len(system.peers_of(f"robot{i}")) == 5


# ---- what is wrong, and where -------------------------------------------------------------------


def put(*path, value):
    def change(found):
        for part in path[:-1]:
            found = found[part]
        found[path[-1]] = value

    return change


CONTROL = ("nodes", "master_control")


@pytest.mark.parametrize(
    ("change", "sentence", "place"),
    [
        (put("messages", "STATE_1", "signals", value=["q1"]),
         "1 signals for 4 values", "messages.STATE_1.signals"),
        (put("messages", "STATE_1", "signals", value=["q1", "q1", "dq1", "dq2"]),
         "signal q1 is carried twice", ""),
        (put("messages", "STATE_1", "signals", value=["q1", "q2", "dq1", "dq3"]), "dq3", ""),
        (put("messages", "STATE_1", "name", value="STAET_1"), "STAET_1", ""),
        (put("buses", "left", "dbc", value="none.dbc"), "not a DBC file that can be used", ""),
        (put(*CONTROL, "phase", value="fast"), "fast", "nodes.master_control.phase"),
        (put(*CONTROL, "guard", value={"port": "tua", "tau_max": 1}),
         "no component of the node has an output 'tua'", "nodes.master_control.guard"),
        (put(*CONTROL, "guard", value={"q_jump": 1, "q": "theta_hat"}),
         "q_jump needs a position or velocity of 2 joints; master_control has 3 theta_hat",
         "nodes.master_control.guard"),
        (put(*CONTROL, "guard", value={"dq_max": 1, "dq": "v"}),
         "dq_max needs a position or velocity of 2 joints; master_control has no 'v'",
         "nodes.master_control.guard"),
        (put("nodes", "master", "drive", value={"port": "force"}),
         "no torque 'force' arrives from another node", "nodes.master.drive"),
        (put("nodes", "master", "drive", value={"q": "angle"}),
         "master has no 'angle'; it has", "nodes.master.drive"),
        (put("nodes", "master", "drive", value={"profile": "none.toml"}), "none.toml", ""),
        (put(*CONTROL, "stale", value={"master_control.xi": {"stop": 1}}),
         "no input 'master_control.xi' from another node; there are: master_control.dq, ",
         "nodes.master_control.stale.master_control.xi"),
        (put(*CONTROL, "stale", value={"master_control.q": {"age": "ages[0]"}}),
         "master_control has no 'ages'", "nodes.master_control.stale.master_control.q.age"),
        (put(*CONTROL, "stale", value={"master_control.q": {"age": "age[1]"}}),
         "'age[1]' is not one of the 1 entries", "nodes.master_control.stale.master_control.q.age"),
        (put(*CONTROL, "stale", value={"master_control.q": {"age": "age[x]"}}),
         "'age[x]' is not one of the 1 entries", "nodes.master_control.stale.master_control.q.age"),
        (put("messages", "LINK_2", "carries",
             value=["master_control.tau[1]", "master_control.tau[0]", "master_control.xi"]),
         "LINK_2 carries master_control.tau in pieces", "nodes.master_control.guard"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said_with_its_place(change, sentence, place, tmp_path):
    found = document()
    change(found)
    with pytest.raises(CosimError) as error:
        system_of(found, tmp_path)
    assert sentence in str(error.value)
    assert f"test.toml at {place}" in str(error.value) if place else True


def test_a_deployment_of_another_scenario_is_refused():
    with pytest.raises(ScenarioError, match="components"):
        load_system(TELEOPERATION, "network-can")
