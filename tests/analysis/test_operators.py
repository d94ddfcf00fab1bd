"""Operators that are separate components: their torque is the force at the port."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.analysis.analysis import analyse
from cosim.analysis.analyzed_port import of_run, of_scenario
from cosim.analysis.contacts import by_grip
from cosim.base.errors import ScenarioError
from cosim.engine.memory_run import trace
from cosim.predict.inputs import RunWithInputs, is_driven
from cosim.predict.system import system
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from fmus.paper.experiments import single, teleoperator
from tests.analysis.cases import DOCUMENTS, Document, bench, number, subject
from tests.cli.command import Command

HAND: Document = {
    "model": "fmus.models.operator",
    "inputs": {"q": "robot.q", "dq": "robot.dq"},
}


def held_by(component: Document, stop: float = 20.0, grip: Any = None) -> Document:
    """The single arm of Sec. VII-A at 1 ms, its external torque fed by `component`."""
    document = single(stop, period=1e-3, grip=grip or {})
    robot = document["components"]["robot"]
    robot = robot | {"inputs": robot["inputs"] | {"tau_ext": "hand.tau_h"}}
    control = document["components"]["control"] | {"period": 5e-3}
    parts = {"robot": robot, "control": control, "hand": {"period": 1e-3, **component}}
    return document | {"components": parts, "run": {"step": 1e-3, "stop": stop}}


def test_an_operator_component_takes_the_effort_of_the_grip_inside() -> None:
    """45.99 N.m.√s and M^t = 0.429 rad/(N.m): the independent simulation of Figs 1 and 2."""
    found = analyse(subject(held_by(HAND)), tests=False)
    assert number(found, "effort").values == pytest.approx([45.99], rel=1e-3)
    assert number(found, "manipulability").values == pytest.approx([0.429], rel=2e-3)
    assert number(found, "work").values[0] > 50.0
    approach = number(found, "approach")
    assert approach.expected == pytest.approx(approach.values, rel=0.05)


def test_a_decaying_push_has_the_effort_of_its_formula() -> None:
    """τ = 1/(t + 1) on two joints: ∫ |τ|² dt = 2 (1 - 1/(T + 1)), ∫ |τ| dt = √2 ln(T + 1)."""
    found = analyse(subject(held_by({"model": "fmus.models.decaying_push"})), tests=False)
    T = 20.0
    assert number(found, "effort").values == pytest.approx([np.sqrt(2 * T / (T + 1))], rel=1e-3)
    assert number(found, "impulse").values == pytest.approx([np.sqrt(2) * np.log(T + 1)], rel=1e-3)


def test_a_component_and_the_grip_inside_add_up() -> None:
    """Two hands of half the stiffness and damping are the hand of Sec. VII-A."""
    half = {"k_p": 5.0, "k_d": 2.5}
    inside = {**half, "q_h": [3.5, 3.0]}
    found = analyse(subject(held_by({**HAND, "parameters": half}, grip=inside)), tests=False)
    assert number(found, "effort").values == pytest.approx([45.99], rel=1e-3)
    approach = number(found, "approach")
    assert approach.expected == pytest.approx(approach.values, rel=0.05)


def test_a_constant_torque_of_the_scenario_is_a_force_too() -> None:
    document = single(5.0, grip={}, arm_values={"tau_ext": [1.0, 0.0]})
    found = analyse(subject(document), tests=False)
    assert number(found, "effort").values == pytest.approx([np.sqrt(5.0)], rel=1e-6)


def test_tests_let_go_of_operators_that_are_components() -> None:
    """The stiffest grip that the test finds is not propped up by the scenario's own operator."""
    heavy = (0.0, 0.0)
    (alone,) = by_grip(bench(held_by({"model": "fmus.models.push"}), heavy, known=True))
    (held,) = by_grip(bench(held_by(HAND), heavy, known=True))
    assert held.values == pytest.approx(alone.values, rel=1e-9)


def test_torque_on_the_far_robot_leaves_the_passivity_observer() -> None:
    """A second hand at the slave: what it puts in is no gift of the teleoperator.

    Nobody holds the master, whose torque is 0, so E is the energy that the second hand puts in.
    """
    document = teleoperator(5.0, grip={})
    slave = document["components"]["slave"]
    slave = slave | {"inputs": slave["inputs"] | {"tau_ext": "hand.tau_h"}}
    push = {"model": "fmus.models.push", "period": 5e-3, "parameters": {"tau_p": [1.0, 0.0]}}
    parts = {**document["components"], "slave": slave, "hand": push}
    found = analyse(subject(document | {"components": parts}, "master"), tests=False)
    (rows,), ((t, E),) = found.recorded, found.recorded.E
    assert rows.far is not None
    assert E[-1] == pytest.approx(np.trapezoid(rows.far[1][:, 0], t), rel=0.01)


def test_a_recorded_run_gets_the_torque_from_its_source(cosim: Command) -> None:
    Path("s.toml").write_text(_TOML)
    cosim("run", "s.toml", "--out", "run", "--no-plot", "--quiet")
    run, scenario = of_run("run"), of_scenario("s.toml")
    force = run.signals.array("robot.tau_ext")
    assert np.array_equal(force[:-1], scenario.signals.array("robot.tau_ext")[:-1])
    done = cosim("analyze", "run", "--no-tests")
    assert "port robot: robot.tau_h + robot.tau_ext, robot.q" in done.out


def test_a_run_without_the_source_is_refused(cosim: Command) -> None:
    Path("s.toml").write_text(_TOML)
    record = 'run.record.signals=["robot.q", "robot.dq", "robot.tau_h"]'
    cosim("run", "s.toml", "--set", record, "--out", "run", "--no-plot", "--quiet")
    said = cosim.refused("analyze", "run")
    assert "robot.tau_ext is fed by hand.tau_h, and neither was recorded" in said


def test_wires_with_a_gain_are_computed_and_links_are_refused() -> None:
    document = held_by(HAND, 0.1)
    robot = document["components"]["robot"]
    inputs = robot["inputs"] | {"tau_ext": {"from": "hand.tau_h", "gain": 2.0}}
    parts = {**document["components"], "robot": robot | {"inputs": inputs}}
    plan = assemble(build(document | {"components": parts}, Path("test.toml")))
    run = RunWithInputs(trace(plan, ["hand.tau_h", "robot.q"]), plan)
    assert np.array_equal(run.array("robot.tau_ext"), 2 * run.array("hand.tau_h"))
    assert run.unit("robot.tau_ext") == "N.m" and len(run.entries("robot.tau_ext")) == 2
    with pytest.raises(ScenarioError, match="no recorded signal"):
        run.array("robot.dq")
    link = {"from": "hand.tau_h", "to": "robot.tau_ext",
            "delay": {"law": "constant", "delay": 0.01}}  # fmt: skip
    del inputs["tau_ext"]
    linked = document | {"components": parts, "links": [link]}
    plan = assemble(build(linked, Path("test.toml")))
    assert is_driven(plan, "robot.tau_ext")
    with pytest.raises(ScenarioError, match="a link or a table feeds it"):
        RunWithInputs(trace(plan, ["hand.tau_h"]), plan).array("robot.tau_ext")


def test_a_hand_that_is_no_spring_to_a_fixed_place_has_no_closed_form() -> None:
    for component in (HAND, {"model": "fmus.models.decaying_push"}):
        scenario = build(held_by(component, 1.0, {"k_p": 1.0, "k_d": 0.5}), Path("test.toml"))
        hand = system(scenario, assemble(scenario)).hand("robot")
        assert (hand is None) == (component is not HAND)
        if hand is not None:
            assert hand.stiffness == (11.0, 11.0) and hand.damping == (5.5, 5.5)
            assert hand.place == pytest.approx((35 / 11, 30 / 11))
    scenario = build(DOCUMENTS["pair-10"], Path("test.toml"))
    assert system(scenario, assemble(scenario)).hand("slave") is None


_TOML = """
title = "an operator that is a component"
run = { step = "1 ms", stop = "1 s" }
[components.robot]
model = "fmus.models.planar2r"
inputs = { tau = "control.tau", tau_ext = "hand.tau_h" }
[components.control]
model = "fmus.models.adaptive"
period = "5 ms"
inputs = { q = "robot.q", dq = "robot.dq" }
[components.hand]
model = "fmus.models.operator"
period = "1 ms"
inputs = { q = "robot.q", dq = "robot.dq" }
"""
