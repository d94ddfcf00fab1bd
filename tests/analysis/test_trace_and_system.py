"""Plans with small differences, runs in memory, and the roles in a plan."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.errors import ScenarioError
from cosim.engine.memory_run import Change, SignalTrace, changed, trace
from cosim.predict.ages import Age, age
from cosim.predict.closed_form import felt_damping
from cosim.predict.facts import Arm, DynamicFeedback, facts_function
from cosim.predict.system import AnalyzedSystem, system
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from cosim.schedule.plan import Plan
from fmus.models.facts import FACTS, planar2r
from fmus.paper.experiments import network, single, teleoperator
from tests.analysis.cases import DOCUMENTS, net_of, pointmass


def planned(document: dict[str, Any]) -> Plan:
    return assemble(build(document, Path("test.toml")))


def known(document: dict[str, Any]) -> AnalyzedSystem:
    scenario = build(document, Path("test.toml"))
    return system(scenario, assemble(scenario))


# ---- changes ------------------------------------------------------------------------------------


def test_a_force_from_a_table_is_a_force_from_a_component() -> None:
    plan = planned(pointmass(2.0))
    component = trace(plan, ["mass.x"])
    played = trace(changed(plan, Change(5.0, forces={"mass.f": np.full((1, 1), 2.0)})), ["mass.x"])
    assert np.array_equal(component.array("mass.x"), played.array("mass.x"))


def test_a_table_begins_again_after_its_end() -> None:
    plan = planned(pointmass(2.0))
    saw = np.array([[1.0], [-1.0], [0.5]])
    run = trace(changed(plan, Change(0.1, forces={"mass.f": saw})), ["mass.f"])
    assert run.array("mass.f")[1:8, 0].tolist() == [1.0, -1.0, 0.5, 1.0, -1.0, 0.5, 1.0]


def test_values_and_length_change_and_the_plan_does_not() -> None:
    plan = planned(pointmass(2.0))
    before = trace(plan, ["mass.x"]).array("mass.x")
    change = Change(1.0, values={"mass": {"b": (0.0,), "dx": (3.0,)}, "push": {"f_p": (0.0,)}})
    run = trace(changed(plan, change), ["mass.x"])
    assert run.t[-1] == 1.0 and run.array("mass.x")[-1, 0] == pytest.approx(3.0)
    assert np.array_equal(trace(plan, ["mass.x"]).array("mass.x"), before)


def test_a_name_that_is_not_there_is_refused() -> None:
    plan = planned(pointmass(2.0))
    with pytest.raises(ScenarioError, match="no parameter or input of mass 'mass'"):
        changed(plan, Change(1.0, values={"mass": {"mass": (1.0,)}}))
    with pytest.raises(ScenarioError, match=r"no signal 'mass\.g'"):
        changed(plan, Change(1.0, forces={"mass.g": np.ones((1, 1))}))


def test_recording_every_so_often_is_a_part_of_recording_all() -> None:
    plan = planned(single(2.0))
    all_, some = trace(plan, ["robot.q"]), trace(plan, ["robot.q"], 7)
    assert np.array_equal(some.array("robot.q"), all_.array("robot.q")[::7])
    assert np.array_equal(some.t, all_.t[::7])
    assert some.unit("robot.q") == "rad" and some.entries("robot.q") == ("robot.q[0]", "robot.q[1]")
    with pytest.raises(ScenarioError, match="no recorded signal"):
        some.array("robot.dq")


def test_a_run_that_stops_keeps_what_there_was() -> None:
    run = trace(planned(single(5.0, K=200.0)), ["robot.q"])
    assert "at tick" in run.stopped and 0 < len(run.t) < 1000
    assert len(run.t) == len(run.array("robot.q"))


# ---- who is who ---------------------------------------------------------------------------------


def test_arms_controllers_and_who_is_held() -> None:
    found = known(DOCUMENTS["pair-10"])
    assert found.controls == {"master": "master_control", "slave": "slave_control"}
    assert found.held() == ("master",)
    assert found.arm_of("slave_control") == "slave" and found.arm_of("nobody") is None
    assert isinstance(found.facts["master"], Arm)
    assert isinstance(found.facts["master_control"], DynamicFeedback)


def test_edges_over_links_and_over_components_in_between() -> None:
    over_link, direct = known(DOCUMENTS["pair-10"]), known(DOCUMENTS["pair-10-wire"])
    for found, delay in ((over_link, 0.75), (direct, 0.0)):
        senders = {e.receiver: e.sender for e in found.edges}
        assert senders == {"master_control": "slave_control", "slave_control": "master_control"}
        assert {(found.age(e.link) if e.link else Age()).mean for e in found.edges} == {delay}
        assert all(e.weight == 1.0 and e.recurrent and e.fed for e in found.edges)


@pytest.mark.parametrize("seed", [0, 3])
def test_weights_of_a_switching_graph_are_those_of_the_mean_graph(seed: int) -> None:
    """One of three graphs at a time has each edge of `ring`: 1/3, whatever the seed draws."""
    found = known(network(5.0, seed=seed))
    assert {e.receiver: e.sender for e in found.edges}["control4"] == "control3"
    assert [e.weight for e in found.edges] == pytest.approx([1 / 3] * 6, rel=1e-12)


def test_felt_damping_of_a_switching_network_is_that_of_the_mean_graph() -> None:
    """Kα/λ_M Σ_i (1 + w T), six arms: 16·1.6/10·6·(1 + 0.75/3) = 19.2 N.m.s/rad with delay.

    At rest in drift every ξ_j is late by T, so each arm is held back by 1 + w T of its own.
    """
    delayed = {"delay": {"law": "uniform", "low": 0.3, "high": 1.2, "hold": 0.03}}
    for link, damping in (({}, 15.36), (delayed, 19.2)):
        for seed in range(3):
            net = net_of(network(5.0, seed=seed, link=link))
            assert felt_damping(net, 16.0) == pytest.approx(damping, rel=1e-5)


@pytest.mark.parametrize(
    ("semantics", "mean", "bound"),
    [("signal", 0.75, 1.2), ("last-arrival", 0.712, 2.1), ("newest-stamp", 0.474, 1.2),
     ("fifo", 1.031, 1.2)],
)  # fmt: skip
def test_mean_ages_are_those_of_the_reading(semantics: str, mean: float, bound: float) -> None:
    """After a stale packet of 1.2 s, the next to arrive may be 0.9 s younger and as slow."""
    link = {"delay": {"law": "uniform", "low": 0.3, "high": 1.2, "hold": 0.03}}
    plan = planned(teleoperator(5.0, link={**link, "semantics": semantics}))
    assert age(plan.links[0].table).mean == pytest.approx(mean, rel=0.05)
    assert bound <= age(plan.links[0].table).bound < bound + 0.05


def test_losses_at_random_leave_the_age_without_a_bound() -> None:
    link = {"delay": {"law": "constant", "delay": 0.1}, "semantics": "newest-stamp",
            "loss": {"law": "independent", "p": 0.1}}  # fmt: skip
    assert age(planned(teleoperator(5.0, link=link)).links[0].table).bound == np.inf
    outage = {**link, "loss": {"law": "outage", "length": 0.5, "every": 5.0}}
    assert age(planned(teleoperator(5.0, link=outage)).links[0].table).bound == pytest.approx(0.61)


def test_links_that_are_alike_have_one_age() -> None:
    """Drawn once for a law, semantics and periods; the seed of a link is its own."""
    link = {"delay": {"law": "uniform", "low": 0.3, "high": 1.2}, "semantics": "last-arrival"}
    document = teleoperator(5.0, link=link)
    found = known(document)
    there, back = found.plan.links
    assert found.age(there) is found.age(back)
    assert age(there.table).mean != age(back.table).mean
    document["links"][1]["semantics"] = "newest-stamp"
    found = known(document)
    there, back = found.plan.links
    assert found.age(back).mean > found.age(there).mean + 0.1


# ---- facts --------------------------------------------------------------------------------------


def test_inertia_bounds_are_those_of_the_reading() -> None:
    """λ_min/λ_max of M over the workspace: SL91 .131/6.58, IMI .146/4.01, heavy .229/9.1."""
    zero = {name: (0.0, 0.0) for name in ("q", "k_p", "k_d", "k_w", "b_w", "q_w", "theta_g")}
    for theta, bounds in (
        ((3.34, 1.20, 0.97), (0.131, 6.58)),
        ((3.473, 0.242, 0.196), (0.146, 4.01)),
        ((16 / 3, 3 / 2, 1.0), (0.229, 9.10)),
    ):
        arm = planar2r({**zero, "theta": theta, "substeps": (5.0,)})
        assert arm.inertia_range == pytest.approx(bounds, abs=5e-3)
        heaviest = np.linalg.eigvalsh(arm.inertia(theta, arm.heaviest))[-1]
        assert heaviest == pytest.approx(arm.inertia_range[1])
        assert arm.h_max == 0.2


def test_every_model_of_the_table_has_facts_of_its_defaults() -> None:
    """A renamed parameter shows here, and not as a finding that is missing."""
    for name in FACTS:
        sizes = {"gravity": 1} if name in ("adaptive", "teleoperation") else {}
        component = {"model": f"fmus.models.{name}", "sizes": sizes}
        found = known({"run": {"step": 0.005, "stop": 1.0}, "components": {"x": component}})
        assert not found.silent and "x" in found.facts, (name, found.silent)


def test_a_module_s_own_facts_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    made = types.ModuleType("lonely")
    made.facts = lambda values: planar2r({**values})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lonely", made)
    zero = {name: (0.0, 0.0) for name in ("q", "k_p", "k_d", "k_w", "b_w", "q_w")}
    values = {**zero, "theta": (3.34, 1.2, 0.97), "substeps": (1.0,)}
    function = facts_function("lonely:Anything")
    assert function is not None and isinstance(function(values), Arm)
    assert facts_function("some/file.fmu") is None
    assert facts_function("tests.cosim.blocks:Gain") is None


def test_facts_that_fail_are_noted_and_stop_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FACTS, "planar2r", lambda values: 1 / 0)  # type: ignore[index]
    found = known(DOCUMENTS["single-6"])
    assert found.silent == {"robot": "ZeroDivisionError: division by zero"}
    assert "control" in found.facts and found.held() == ()


def test_the_motion_without_a_force_is_subtracted_from_a_push() -> None:
    t = np.linspace(0.0, 1.0, 3)
    before = SignalTrace(t, {"x": np.array([[1.0], [0.5], [0.2]])}, {}, {})
    after = SignalTrace(t, {"x": np.array([[1.0], [0.6], [0.4]]), "f": np.ones((3, 1))}, {}, {})
    left = after.less(before)
    assert left.array("x")[:, 0] == pytest.approx([0.0, 0.1, 0.2])
    assert left.array("f")[:, 0] == pytest.approx([1.0, 1.0, 1.0])
    assert not before.constant
    assert SignalTrace(t, {"f": np.ones((3, 1))}, {}, {}).constant
