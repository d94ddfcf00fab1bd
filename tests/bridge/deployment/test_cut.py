"""Cutting changes nothing: the plans of the nodes are the plan, in pieces."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest

from bridge.deployment.cut import cut_plan, start_values
from bridge.deployment.spec import find, load
from cosim.base.errors import ScenarioError
from cosim.engine.engine import Engine
from cosim.loading.files import load as load_scenario
from cosim.scenario.assemble import assemble
from cosim.schedule.parts import Link
from tests.bridge.deployments import (
    NETWORK,
    SHORT,
    TELEOPERATION,
    document,
    named,
    offline,
    one_node,
    run_twin,
    system_of,
    written,
)


@pytest.fixture(params=["can", "can-classic", "network-can"])
def pieces(request):
    """(whole plan, system)."""
    system = named(request.param)
    return system.plan, system


def test_every_signal_is_in_one_node_and_keeps_shape_and_unit(pieces):
    plan, system = pieces
    found = [s for n in system.nodes.values() for s in n.plan.slots().values()]
    assert {s.name: (s.shape, s.unit) for s in found} == {
        name: (s.shape, s.unit) for name, s in plan.slots().items()
    }
    assert len(found) == len(plan.slots())
    assert sum(n.plan.n_signals for n in system.nodes.values()) == plan.n_signals


def test_every_component_keeps_its_period_in_seconds_and_its_values(pieces):
    plan, system = pieces
    for node in system.nodes.values():
        assert node.slots * node.ticks == plan.ticks
        for step in node.plan.components:
            whole = plan.component(step.name)
            assert step.period * node.ticks == whole.period
            assert step.values == whole.values
            assert step.kind == whole.kind


def test_every_edge_is_inside_a_node_or_crosses_and_is_carried(pieces):
    plan, system = pieces
    inside = [e for n in system.nodes.values() for e in (*n.plan.wires, *n.plan.links)]
    crossing = [i for n in system.nodes.values() for i in n.inlets]
    whole = {(e.source.name, e.target.name) for e in (*plan.wires, *plan.links)}
    kept = {(e.source.name, e.target.name) for e in inside}
    cut_ = {(i.source.name, i.target.name) for i in crossing}
    assert kept | cut_ == whole
    assert not kept & cut_
    for inlet in crossing:
        outlet = system.messages[inlet.message].outlet
        values = [name for part in outlet.parts for name in part.scalars()]
        first = inlet.first
        assert tuple(values[first : first + inlet.source.size]) == inlet.source.scalars()


def test_every_player_plays_in_the_node_of_its_input(pieces):
    plan, system = pieces
    found = {p.target.name: n.name for n in system.nodes.values() for p in n.plan.players}
    assert set(found) == {p.target.name for p in plan.players}
    for target, node in found.items():
        assert target.partition(".")[0] in system.deployment.nodes[node].components


def test_inputs_from_other_nodes_start_as_they_start_offline(pieces):
    plan, system = pieces
    start = start_values(assemble(system.scenario))
    for node in system.nodes.values():
        with Engine(node.plan, gates={g.name: (0, 0) for g in node.plan.gates}) as engine:
            engine.initialize()
            own = engine.signals.copy()
        for name, slot in node.plan.slots().items():
            whole = plan.slots()[name]
            assert (
                own[slot.start : slot.start + slot.size].tolist()
                == start[whole.start : whole.start + whole.size].tolist()
            )


@pytest.mark.parametrize(
    ("scenario", "stop"), [(TELEOPERATION, "run.stop=10"), (NETWORK, "run.stop=5")]
)
def test_one_node_with_everything_is_the_offline_run_to_the_bit(scenario, stop, tmp_path):
    components = [c.name for c in assemble(load_scenario(scenario)).components]
    system = system_of(one_node(components), tmp_path, stop, scenario=scenario)
    rows = run_twin(system, tmp_path / "twin")["all"]
    run = offline(scenario, tmp_path / "offline", stop, "run.record.every=1")
    slots = system.nodes["all"].plan.slots()
    scalars = {n: s.start + i for s in slots.values() for i, n in enumerate(s.scalars())}
    assert len(rows) == system.plan.ticks
    for name in run.names:
        found, expected = rows["signals"][:, scalars[name]], run.column(name)[:-1]
        assert found.tobytes() == expected.tobytes(), name


# ---- one entry of a port in a message -----------------------------------------------------------


def by_joint():
    """Torques of the master in a message a joint; the second one first."""
    found = document()
    found["messages"]["LINK_2"]["carries"] = ["master_control.tau[1]", "master_control.xi"]
    found["messages"]["LINK_2"]["signals"] = ["tau2", "xi1", "xi2"]
    found["messages"]["LINK_5"] = {"bus": "left", "carries": ["master_control.tau[0]"]}
    return found


def test_entries_of_a_port_may_travel_in_several_messages(tmp_path):
    system = system_of(by_joint(), tmp_path, SHORT)
    inlets = {i.target.name: (i.message, i.first) for i in system.nodes["master"].inlets}
    assert inlets == {"master.tau[0]": ("LINK_5", 0), "master.tau[1]": ("LINK_2", 0)}
    assert [s.name for s in system.messages["LINK_5"].encoding.signals] == ["tau1"]


def test_entries_arrive_where_the_whole_port_would(tmp_path):
    whole = system_of(document(), tmp_path, SHORT)
    parts = system_of(by_joint(), tmp_path, SHORT)
    a = run_twin(whole, tmp_path / "whole")
    b = run_twin(parts, tmp_path / "parts")
    slot = whole.nodes["master"].plan.slots()["master.q"]
    difference = np.abs(a["master"]["signals"] - b["master"]["signals"])
    assert difference[:, slot.start : slot.start + 2].max() < 1e-2
    assert b["master"]["inlets"]["held"][-1].tolist() == [399, 399]


def test_all_entries_of_a_torque_are_guarded_also_one_by_one(tmp_path):
    found = document()
    found["nodes"]["master_control"]["guard"] = {"tau_max": [1.0, 2.0]}
    found["messages"]["LINK_2"]["carries"] = [
        *("master_control.tau[0]", "master_control.tau[1]", "master_control.xi")
    ]
    sent = run_twin(system_of(found, tmp_path, SHORT), tmp_path / "a")["master_control"]["sent"]
    assert np.abs(sent[:, :2]).max(axis=0).tolist() == [1.0, 2.0]
    found = by_joint()
    found["nodes"]["master_control"]["guard"] = {"tau_max": [1.0, 2.0]}
    sent = run_twin(system_of(found, tmp_path, SHORT), tmp_path / "b")["master_control"]["sent"]
    assert np.abs(sent[:, [3, 0]]).max(axis=0).tolist() == [1.0, 2.0]


# ---- rates --------------------------------------------------------------------------------------


def test_a_message_may_be_sent_less_often_than_its_component_runs(tmp_path):
    found = document()
    found["messages"]["STATE_1"]["period"] = "5 ms"
    outlet = system_of(found, tmp_path).messages["STATE_1"].outlet
    assert (outlet.period, outlet.ticks) == (5, 5)


def test_the_age_of_a_link_that_crosses_a_cut_arrives(tmp_path):
    changes = ['links.0.age="slave_control.age[0]"', SHORT]
    found = document()
    del found["nodes"]["slave_control"]["stale"]["slave_control.xi_in"]
    system = system_of(found, tmp_path, *changes)
    inlet = next(i for i in system.nodes["slave_control"].inlets if i.link)
    assert inlet.age is not None
    rows = run_twin(system, tmp_path / "twin")["slave_control"]
    age = rows["signals"][:, inlet.age.start]
    i = system.nodes["slave_control"].inlets.index(inlet)
    held = rows["inlets"]["held"][:, i]
    nominal = rows["slot"] * 5_000_000 - np.maximum(held, 0) * 5_000_000
    assert age.tolist() == (nominal * 1e-9).tolist()
    assert held.max() > 100


# ---- what is wrong, and where -------------------------------------------------------------------


def wrong(tmp_path, change, *settings):
    """The sentence of a changed deployment."""
    found = document()
    change(found)
    deployment = load(written(found, tmp_path))
    plan = assemble(load_scenario(TELEOPERATION, settings))
    with pytest.raises(ScenarioError) as error:
        cut_plan(plan, deployment, start_values(plan))
    return str(error.value)


def put(*path, value):
    def change(found):
        for part in path[:-1]:
            found = found[part]
        found[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "sentence", "place"),
    [
        (put("nodes", "slave", "components", value=["slvae"]),
         "no component 'slvae'; the scenario has: master, master_control, slave",
         "nodes.slave.components"),
        (put("nodes", "slave", "components", value=[]),
         "has no component and forwards nothing", "nodes.slave.components"),
        (put("messages", "STATE_1", "carries", value=[]),
         "is empty; expected outputs", "messages.STATE_1.carries"),
        (put("messages", "STATE_1", "carries", value=["master.q", "slave.dq"]),
         "has outputs of several components", "messages.STATE_1.carries"),
        (put("messages", "STATE_1", "carries", value=["master.q", "master.tau"]),
         "no output 'master.tau' in the scenario", "messages.STATE_1.carries"),
        (put("messages", "STATE_1", "carries", value=["master.q[2]"]),
         "no output 'master.q[2]' in the scenario", "messages.STATE_1.carries"),
        (put("messages", "STATE_1", "carries", value=["master.q", "master.q[0]"]),
         "master.q[0] is in STATE_1 already", "messages.STATE_1.carries"),
        (put("messages", "X", value={"bus": "left", "carries": ["slave.dq"]}),
         "slave.dq[0] is in STATE_3 already", "messages.X.carries"),
        (lambda found: found["messages"].pop("STATE_1"),
         "crosses a cut, but no message carries master.", "messages"),
        (put("messages", "STATE_1", "carries", value=["master.q[0]", "master.dq"]),
         "master.q -> master_control.q crosses a cut, but no message carries master.q[1]",
         "messages"),
        (put("messages", "STATE_1", "period", value="1.5 ms"),
         "0.0015 s is no multiple of master's period 0.001 s", "messages.STATE_1.period"),
        (put("messages", "LINK_2", "period", value="1 ms"),
         "0.001 s is no multiple of master_control's period 0.005 s", "messages.LINK_2.period"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_said_with_its_place(change, sentence, place, tmp_path):
    said = wrong(tmp_path, change)
    assert sentence in said
    assert f"test.toml at {place}" in said


def test_a_component_without_a_node_is_named(tmp_path):
    def change(found):
        found["nodes"]["slave_control"]["requires"] = []
        del found["nodes"]["slave"]

    assert "test.toml at nodes: no node for slave" in wrong(tmp_path, change)


def test_other_algorithms_are_not_cut(tmp_path):
    said = wrong(tmp_path, lambda found: None, "run.algorithm=jacobi")
    assert '"jacobi" cannot be cut into nodes; expected "sampled"' in said


def test_what_crosses_is_what_two_nodes_share():
    system = named("can")
    crossing = {i.source.name for n in system.nodes.values() for i in n.inlets}
    sent = set(chain.from_iterable(o.carries for n in system.nodes.values() for o in n.outlets))
    assert crossing == sent
    links = [i.link for n in system.nodes.values() for i in n.inlets if i.link]
    assert len(links) == 2 and all(isinstance(x, Link) for x in links)
    assert find(TELEOPERATION, "can") == system.deployment.path
