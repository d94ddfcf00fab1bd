"""Robots that take positions or velocities: what a check says of servos, and what a run does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.analysis.analyzed_port import find_port
from cosim.analysis.experiments import Bench
from cosim.analysis.force_tests import by_push
from cosim.checks import Finding
from cosim.checks.preflight import check
from cosim.engine.memory_run import Change, changed, trace
from cosim.loading.files import load
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build

CONFIGS = Path(__file__).parents[3] / "configs"
POSITION, VELOCITY = CONFIGS / "six_axis_position.toml", CONFIGS / "six_axis_velocity.toml"


def findings(scenario: Scenario) -> dict[str, Finding]:
    return {f.rule: f for f in check(scenario, assemble(scenario))}


# ---- who commands whom --------------------------------------------------------------------------


def test_the_law_is_found_behind_servo_and_commands() -> None:
    scenario = load(POSITION)
    known, _ = find_port(scenario, assemble(scenario))
    assert known.controls == {"master": "master_control", "slave": "slave_control"}
    assert known.commands["master"].by == "master_command" and not known.commands["master"].direct
    assert {e.receiver: e.sender for e in known.edges} == {
        "master_control": "slave_control", "slave_control": "master_control"
    }  # fmt: skip
    scenario = load(VELOCITY)
    known, _ = find_port(scenario, assemble(scenario))
    law: Any = known.facts["slave_control"]
    assert known.commands["slave"].direct and law.K == (20.0, 20.0, 12.0, 1.0, 1.0, 1.0)
    assert known.feedback_period("slave_control") == 0.001


# ---- gains, and the period of the commands ------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("parameters.K_v=[20,20,12,1,1,2]", "K_v"),
        ("parameters.K_p=[200,200,120,10,10,20]", "K_p"),
        ("parameters.feed_forward=0.5", "feed_forward"),
        ("period='2 ms'", "the period (0.002 s; T_c = 0.004 s)"),
    ],
)
def test_commands_for_another_servo_are_a_warning(setting: str, named: str) -> None:
    assert "servo-gains" not in findings(load(POSITION))
    said = findings(load(POSITION, [f"components.slave_command.{setting}"]))["servo-gains"]
    assert said.severity == "warning" and said.where == "slave_command" and named in said.reason


def test_slow_commands_make_an_arm_heavy() -> None:
    """A note of 26 % at 4 ms; at 20 ms a warning, of K_v T/(1 - exp(-K_v T/M)) over M."""
    settings = [f"components.{n}_command.period='20 ms'" for n in ("master", "slave")]
    said = findings(load(POSITION, settings))["servo-inertia"]
    scenario = load(POSITION)
    arm = find_port(scenario, assemble(scenario))[0].arms["master"]
    M = np.diag(arm.inertia(arm.parameters, arm.q))
    x = np.array([20.0, 20.0, 12.0, 1.0, 1.0, 1.0]) * 0.02 / M
    assert said.severity == "warning"
    assert said.number == pytest.approx(np.max(x / (1 - np.exp(-x))) - 1)
    assert findings(scenario)["servo-inertia"].severity == "note"


# ---- limits that act ----------------------------------------------------------------------------

BOTH = ("master", "slave")


def in_velocity_mode(*, K_p: str = "", **servo: float) -> list[str]:
    """Changes to the scenario of positions: commands of velocities, and values of the servos."""
    settings = []
    for n in BOTH:
        wires = f'{{q="{n}.q",dq="{n}.dq",dq_c="{n}_command.dq_c"}}'
        settings += [f"components.{n}_servo.inputs={wires}"]
        settings += [f"components.{n}_{c}.parameters.mode=0" for c in ("servo", "command")]
        settings += [f"components.{n}_{c}.parameters.K_p={K_p or 0}" for c in ("servo", "command")]
        settings += [f"components.{n}_servo.parameters.{k}={v}" for k, v in servo.items()]
    return settings


def apart(scenario: Scenario) -> float:
    """How far the arms are from each other at the end, rad."""
    run = trace(assemble(scenario), ["master.q", "slave.q"], 100)
    return float(np.abs(run.array("master.q")[-1] - run.array("slave.q")[-1]).max())


def test_limits_in_position_mode_leave_nothing_behind() -> None:
    """A tenth of the velocity, which the commands do not know, and little more than gravity."""
    few = "[2,32,14,1.5,0.8,0.5]"
    settings = [f"components.{n}_servo.parameters.v_max=0.3" for n in BOTH]
    settings += [f"components.{n}_servo.parameters.tau_max={few}" for n in BOTH]
    assert apart(load(POSITION, settings)) < 1e-4


def test_an_integral_in_velocity_mode_keeps_what_a_limit_took() -> None:
    given = "[200,200,120,10,10,10]"
    without, kept = load(POSITION, in_velocity_mode()), load(POSITION, in_velocity_mode(K_p=given))
    assert "servo-integral" not in findings(without) and apart(without) < 1e-4
    assert findings(kept)["servo-integral"].severity == "warning" and apart(kept) > 0.03


def test_a_velocity_mode_holds_what_its_gain_and_its_limit_allow() -> None:
    """At joint 4 the gain gives 0.3 N.m, and 6 N.m at joint 2, which holds 16 N.m: it falls."""
    slow = load(POSITION, in_velocity_mode(v_max=0.3))
    said = findings(slow)["servo-torque"]
    assert said.number == pytest.approx(0.3) and "joint 4" in said.reason
    assert apart(slow) > 0.5
    assert "servo-torque" not in findings(load(POSITION, in_velocity_mode()))


# ---- laws that command velocities ---------------------------------------------------------------


def kinematic(K_v: float, **law: float) -> Scenario:
    """Two arms of one joint of 0.5 kg.m2 and the kinematic law; the slave starts 1 rad away."""
    parts: dict[str, Any] = {}
    servo: dict[str, float] = {"K_v": K_v}
    if "K_p" in law:
        servo |= {"mode": 1.0, "K_p": law.pop("K_p"), "T_c": 0.001}
    for name, q in (("master", 0.0), ("slave", 1.0)):
        parts[name] = {
            "model": "fmus.models.arm", "sizes": {"joints": 1}, "start": {"q": [q]},
            "inputs": {"tau": f"{name}_servo.tau"},
            "parameters": {"armature": [0.46975], "k_p": 0.01 if name == "master" else 0.0},
        }  # fmt: skip
        control = f"{name}_control"
        parts[f"{name}_servo"] = {
            "model": "fmus.models.servo", "sizes": {"joints": 1}, "parameters": servo,
            "inputs": {"q": f"{name}.q", "dq": f"{name}.dq", "dq_c": f"{control}.dq_c",
                       "q_c": f"{control}.q_c"},
        }  # fmt: skip
        parts[control] = {
            "model": "fmus.models.kinematic", "sizes": {"joints": 1}, "period": 0.001,
            "inputs": {"q": f"{name}.q", "dq": f"{name}.dq"},
            "parameters": {"alpha": 0.5, "lambda": 2.0, "lambda_M": 1.0, **law},
        }  # fmt: skip
    links = [
        {"from": f"{a}_control.xi", "to": f"{b}_control.xi_in[0]",
         "delay": {"law": "constant", "delay": 0.001}, "semantics": "newest-stamp"}
        for a, b in (("master", "slave"), ("slave", "master"))
    ]  # fmt: skip
    run = {"step": 0.001, "stop": 3.0}
    return build({"run": run, "components": parts, "links": links}, Path("one.toml"))


@pytest.mark.parametrize(("K_v", "ratio"), [(25.0, 20.0), (8.75, 7.0), (1.25, 1.0)])
def test_a_servo_must_be_fast_against_the_coupling(K_v: float, ratio: float) -> None:
    """K_v/M over lambda + alpha; what the coupling asks for is missed by the inverse of that."""
    scenario = kinematic(K_v)
    said = findings(scenario)["servo-bandwidth"]
    assert said.number == pytest.approx(ratio)
    assert said.severity == ("warning" if ratio < 5 else "note")
    assert (said.advice == "") == (ratio > 10)
    run = trace(assemble(scenario), ["master.q", "slave.q"])
    apart = (run.array("slave.q") - run.array("master.q"))[:, 0]
    worst = float(np.abs(apart - coupled(run.t)).max())
    assert worst == pytest.approx(0.074 / ratio, rel=0.1)  # 1.5 % of the distance at 5 times


def coupled(t: np.ndarray) -> np.ndarray:
    """q_slave - q_master of two arms that are their commands, from rest, hardly held.

    With d = q_slave - q_master and xi_d = dd + alpha d: d' = -alpha d + xi_d and
    xi_d' = -2 lambda xi_d, from ddq = -alpha dq - lambda (xi - xi_j); xi_d(0) = alpha d(0).
    """
    alpha, rate = 0.5, 4.0
    xi = alpha * np.exp(-rate * t)
    return (1 - alpha / (alpha - rate)) * np.exp(-alpha * t) + xi / (alpha - rate)


def test_a_servo_that_holds_its_position_is_not_moved_by_a_push() -> None:
    said = findings(kinematic(25.0, K_p=100.0))
    assert said["servo-holds"].severity == "warning" and said["servo-holds"].number == 100.0
    assert "felt-damping" not in said
    assert "servo-holds" not in findings(kinematic(25.0))
    assert "servo-holds" not in findings(kinematic(25.0, K_p=100.0, b=2.0))


# ---- what a hand feels --------------------------------------------------------------------------


@pytest.mark.parametrize("K_v", [25.0, 2.5])
def test_a_push_on_a_kinematic_arm_is_felt_as_predicted(K_v: float) -> None:
    scenario = kinematic(K_v)
    found, port = find_port(scenario, assemble(scenario))
    (push,) = [q for q in by_push(Bench(found, port, (0.0,))) if q.name == "push_damping"]
    assert push.expected == pytest.approx([K_v * 0.5 * 2], rel=0.02)
    assert push.values == pytest.approx(push.expected, rel=2e-3)


def test_a_measured_push_moves_two_arms_that_take_positions() -> None:
    """Both at b tau_m/(alpha (2 + lambda ΣT)), whatever their servos hold against the push."""
    scenario = kinematic(25.0, K_p=100.0, b=2.0)
    scenario.components["master_control"].start["tau_m"] = [0.3]
    run = trace(changed(assemble(scenario), Change(15.0)), ["master.dq", "slave.dq"], 10)
    expected = 2.0 * 0.3 / (0.5 * (2 + 2.0 * 2 * 0.001))
    late = run.t > 12.0
    for name in ("master.dq", "slave.dq"):
        assert run.array(name)[late].mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("path", [POSITION, VELOCITY], ids=lambda path: path.stem)
def test_a_push_on_arms_behind_servos_is_felt_as_predicted(path: Path) -> None:
    """O4 with K of the law, or of the servo: six joints, 2 % for 60 s with a constant delay."""
    constant = "={law='constant',delay=0.1}"
    ways = ["links.2.delay" + constant, "links.3.delay" + constant]
    level = [
        setting
        for name in ("master", "slave")
        for setting in (
            f"components.{name}.parameters.g=[0,0,0]",
            f"components.{name}_control.parameters.gravity=0",
        )
    ]
    scenario = load(path, [*ways, *level])
    found, port = find_port(scenario, assemble(scenario))
    q = found.arms["master"].q
    (push,) = [x for x in by_push(Bench(found, port, q)) if x.name == "push_damping"]
    assert push.expected and push.values == pytest.approx(push.expected, rel=0.02)
