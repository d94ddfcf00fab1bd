"""Arms of n joints: what is predicted from their tables, against tables and against runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.analysis.analysis import analyse
from cosim.analysis.analyzed_port import find_port, of_scenario
from cosim.analysis.experiments import Bench
from cosim.analysis.force_tests import by_push, sweep
from cosim.base.copies import replace
from cosim.checks import Finding
from cosim.checks.preflight import check
from cosim.engine.memory_run import trace
from cosim.predict import closed_form as closed
from cosim.predict.facts import DynamicFeedback
from cosim.predict.frequency import PortGain
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import Scenario, build
from fmus.arms import chain
from fmus.models import serial_facts
from fmus.models.arm import model
from tests.tiers import first_fast

ROOT = Path(__file__).parents[2]
#: Rods that turn about z in a plane with gravity along -y; unlike rotors, friction and gains.
TABLE = {"g": [0.0, -9.81, 0.0], "armature": [0.05, 0.02, 0.004]}
K = [4.0, 2.0, 0.4]
DAMPING = [0.5, 0.2, 0.05]
START = [-1.2, 0.5, 0.4]


def document(*, delay: float = 0.1, period: float = 0.002, **law: Any) -> dict[str, Any]:
    """Two arms of three rods under the paper's law; a hand holds the master where it starts."""
    gains = {"K": K, "alpha": 0.5, "lambda": 2.0, "lambda_M": 4.0, "Gamma": 0.0, **law}
    rods = np.reshape(chain_defaults()["inertia"], (3, 10)).tolist()
    grip = {"k_p": [20.0, 10.0, 2.0], "k_d": [4.0, 2.0, 0.4], "q_h": START}
    parts: dict[str, Any] = {}
    for name in ("master", "slave"):
        parts[name] = {
            "model": "fmus.models.arm",
            "sizes": {"joints": 3},
            "inputs": {"tau": f"{name}_control.tau"},
            "start": {"q": START},
            "parameters": {**TABLE, "damping": DAMPING, **(grip if name == "master" else {})},
        }
        parts[f"{name}_control"] = {
            "model": "fmus.models.arm_teleoperation",
            "sizes": {"joints": 3},
            "period": period,
            "inputs": {"q": f"{name}.q", "dq": f"{name}.dq"},
            "start": {"theta_hat": rods},
            "parameters": {**TABLE, **gains},
        }
    links = [
        {"from": f"{a}_control.xi", "to": f"{b}_control.xi_in[0]", "semantics": "newest-stamp",
         "delay": {"law": "constant", "delay": delay}}
        for a, b in (("master", "slave"), ("slave", "master"))
    ]  # fmt: skip
    return {"run": {"step": 0.001, "stop": 30.0}, "components": parts, "links": links}


def chain_defaults() -> dict[str, Any]:
    """The default values of an arm of three joints, by name."""
    return {
        v.name: np.broadcast_to(np.ravel(v.start), (int(np.prod(v.shape)),))
        if np.size(v.start) == 1 else np.ravel(v.start)
        for v in model(3).variables
    }  # fmt: skip


def scenario_of(**changes: Any) -> Scenario:
    return build(document(**changes), Path("rods.toml"))


def findings(scenario: Scenario) -> dict[str, Finding]:
    return {f.rule: f for f in check(scenario, assemble(scenario))}


def bench_of(scenario: Scenario, *, known: bool = False) -> Bench:
    found, port = find_port(scenario, assemble(scenario))
    return Bench(found, port, tuple(START), known)


# ---- the table ----------------------------------------------------------------------------------


def test_inertia_gravity_and_extremes_are_those_of_the_table() -> None:
    """An arm with a prismatic joint; the posture that `slowest` names has the least eigenvalue."""
    draw = np.random.default_rng(4)
    values = {name: tuple(np.ravel(value).tolist()) for name, value in chain_defaults().items()}
    values |= {"joint_type": (0.0, 1.0, 0.0), "armature": (0.3, 0.2, 0.1), "g": (1.0, -2.0, 9.0)}
    values |= {"q_min": (-1.0, 0.0, -1e6), "q_max": (1.0, 0.4, 1e6)}
    arm = serial_facts.arm(values)
    table = serial_facts.table_of(values)
    assert arm.workspace is not None and arm.postures is not None
    for k in draw.integers(0, len(arm.postures), 5):
        q = arm.postures[k]
        assert arm.workspace[k] == pytest.approx(chain.mass_matrix(table, q), rel=1e-12, abs=1e-14)
        still = np.zeros(3)
        assert arm.weight is not None
        assert arm.weight(arm.gravity, q) == pytest.approx(chain.inverse(table, q, still, still))
    assert (np.abs(arm.postures[:, :2]) <= (1.0, 0.4)).all()
    gains = (5.0, 1.0, 0.2)
    rates = [np.linalg.eigvals(np.linalg.inv(M) * gains).real for M in arm.workspace]
    least, _, q = arm.slowest(gains)
    there = np.linalg.inv(arm.inertia(arm.parameters, q)) * gains
    assert least == pytest.approx(np.min(rates)) == pytest.approx(np.linalg.eigvals(there).min())


# ---- what a hand feels --------------------------------------------------------------------------


def test_a_push_is_felt_as_predicted_with_friction() -> None:
    """K alpha (2 + lambda ΣT)/lambda_M + 2 D, per joint, in the check and in a run."""
    scenario = scenario_of()
    expected = [k * 0.5 * (2 + 2 * 0.2) / 4 + 2 * d for k, d in zip(K, DAMPING, strict=True)]
    said = findings(scenario)["felt-damping"]
    assert said.number == pytest.approx(min(expected), rel=1e-2)
    assert "2.2, 1, 0.2" in said.reason.replace("2.21", "2.2").replace("1.01", "1")
    push = {q.name: q for q in by_push(bench_of(scenario, known=True))}["push_damping"]
    assert push.expected == pytest.approx(expected, rel=3e-2)  # gravity adds g' T_s/2
    assert push.values == pytest.approx(push.expected, rel=1e-3)


def test_the_port_by_frequency_is_beside_its_closed_form() -> None:
    """Slow damping to 0.2 %, with gravity that is compensated late by half a period."""
    bench = bench_of(scenario_of())
    found = sweep(bench, 0.1)
    assert found.closed is not None and bench.network is not None
    measured = found.measured.fitted_impedance(0.1, 0.8)
    expected = found.closed.fitted_impedance(0.1, 0.8)
    assert measured[1] == pytest.approx(expected[1], rel=2e-3)
    late = replace(bench.network, periods=())  # as if gravity were compensated at once
    omega = found.measured.omega
    at_once = late.at(START, late.initial_estimates()).gain(1j * omega)
    without = PortGain(omega, at_once, 1e-9).fitted_impedance(0.1, 0.8)[1]
    assert np.abs(measured[1] / without - 1).max() > 4e-3
    quick = found.measured.fitted_impedance(10.0, 60.0)[0]  # K acts half a period late
    expected_quick = found.closed.fitted_impedance(10.0, 60.0)[0]
    assert quick + np.array(K) * 0.001 == pytest.approx(expected_quick, rel=0.03)


# ---- grips --------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_grip_of_unlike_joints_begins_to_swing_where_it_is_predicted(share: float) -> None:
    """Theta known, the friction small: the multiple of a grip at which det(1 + ...) = 0."""
    gains = {"K": [1.0, 0.5, 0.1], "lambda_M": 12.0}
    scenario = scenario_of(period=0.001, **gains)
    slack = {"damping": [0.02, 0.01, 0.002]}
    bench = bench_of(scenario, known=True)
    bench = replace(bench, held={"master": slack, "slave": slack})
    net = bench.network
    assert net is not None
    arms = tuple(replace(arm, damping=tuple(slack["damping"])) for arm in net.arms)
    shape = np.array([20.0, 10.0, 2.0])
    limit = closed.stiffest_network_grip(replace(net, arms=arms), START, shape.tolist())
    place = tuple(x + 1e-3 for x in START)
    hand = {"k_p": tuple(share * limit * shape), "k_d": (0.0,), "q_h": place}
    change = bench.at_rest(30.0).merged(master=hand)
    assert bench.does_not_grow(change, ("master.dq",)) == (share < 1)


def test_the_passive_limit_is_that_of_the_joint_that_is_worst() -> None:
    scenario = scenario_of(lambda_M=40.0)
    plan = assemble(scenario)
    arm = find_port(scenario, plan)[0].arms["master"]
    assert arm.workspace is not None
    damped = np.add(K, DAMPING)
    limits = [np.linalg.eigvals(np.linalg.inv(M) * damped).real.min() for M in arm.workspace]
    said = findings(scenario)["passivity"]
    fast = 0.5 + min(limits) + 2.0  # lambda w of the other arm, whose echo takes a little away
    limit = float(said.reason.split("up to lambda_M = ")[1].split(" ")[0])
    assert fast - 0.5 < limit <= fast and said.number < -0.01


@pytest.mark.parametrize(("natural", "adaptation"), [(0.0, "Gamma"), (0.5, "natural")])
def test_gamma_counts_unless_adaptation_is_natural(natural: float, adaptation: str) -> None:
    scenario = scenario_of(Gamma=0.25, natural=natural)
    law = find_port(scenario, assemble(scenario))[0].facts["master_control"]
    assert isinstance(law, DynamicFeedback)
    assert law.adaptation == (adaptation,)
    assert set(law.Gamma) == ({0.25} if adaptation == "Gamma" else {0.0})


# ---- sampling -----------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.85, 1.15])
def test_a_joint_swings_up_where_the_check_says_that_its_period_is_too_long(share: float) -> None:
    """Only the light last joint has a gain that is too high for its inertia with its rotor."""
    rods = scenario_of()
    arm = find_port(rods, assemble(rods))[0].arms["master"]
    inverse = np.linalg.inv(arm.inertia(arm.parameters, START))
    gain = share * 2 / (0.005 * inverse[2, 2])  # the other joints have almost no gain
    changes = {"K": [1e-3, 1e-3, gain], "lambda": 0.0, "lambda_M": 0.0, "alpha": 1e-3}
    scenario = scenario_of(period=0.005, **changes)
    start = {"dq": [0.0, 0.0, 1e-3]}
    parts = {n: dict(c, start={**c["start"], **start}) if n in ("master", "slave") else c
             for n, c in document(period=0.005, **changes)["components"].items()}  # fmt: skip
    for part in ("master", "slave"):
        parts[part]["parameters"] = {**TABLE, "damping": 0.0}
    changed = build({"run": {"step": 0.001, "stop": 1.0}, "components": parts,
                     "links": document()["links"]}, Path("rods.toml"))  # fmt: skip
    said = [f for f in check(scenario, assemble(scenario)) if f.rule == "poles"]
    assert bool(said) == (share > 1)
    assert all("dq[2]" in f.reason for f in said)
    moved = np.abs(trace(assemble(changed), ["slave.dq"]).array("slave.dq")[:, 2])
    assert (moved[-50:].max() > 1e-3) == (share > 1)


# ---- gravity ------------------------------------------------------------------------------------


def test_a_payload_that_the_controller_does_not_know_holds_the_arms_apart() -> None:
    """At rest the coupling carries what gravity leaves over: kappa (q_slave - q_master)."""
    given = document(lambda_M=1.0)
    rods = np.reshape(chain_defaults()["inertia"], (3, 10))
    loaded = rods.copy()
    loaded[2, :2] += 0.05, 0.05 * 0.3  # 50 g at the end of the last rod
    loaded[2, [6, 9]] += 0.05 * 0.3**2
    given["components"]["slave"]["parameters"]["inertia"] = loaded.tolist()
    scenario = build(given, Path("rods.toml"))
    plan = assemble(scenario)
    said = next(f for f in check(scenario, plan) if f.rule == "gravity")
    assert said.where == "slave_control"
    arm = find_port(scenario, plan)[0].arms["slave"]
    assert arm.weight is not None
    knows = serial_facts.weights({"inertia": tuple(rods.ravel()), "g": (0.0, -9.81, 0.0)})

    def missing(q: np.ndarray) -> np.ndarray:
        assert arm.weight is not None
        return np.asarray(arm.weight(arm.gravity, q) - arm.weight(knows, q))

    assert said.number == pytest.approx(np.abs(missing(np.array(START))).max())
    run = trace(plan, ["master.q", "slave.q"])
    master, slave = run.array("master.q")[-1], run.array("slave.q")[-1]
    kappa = 2.0 * 0.5 * np.array(K) / 1.0
    assert np.abs(missing(slave)).max() > 0.05
    assert kappa * (master - slave) == pytest.approx(missing(slave), rel=0.02, abs=2e-3)


# ---- shipped scenarios --------------------------------------------------------------------------


@pytest.mark.parametrize("name", first_fast(["six_axis.toml", "openarm.toml"]))
def test_a_run_settles_as_the_check_and_the_slowest_pole_say(name: str) -> None:
    """The check has it from the same run; the rate is beside the slowest pole."""
    found = of_scenario(ROOT / "configs" / name)
    assert found.system is not None
    scenario = found.system.scenario
    notes = check(scenario, found.system.plan)
    said = next(f for f in notes if f.rule == "settling")
    t, q = found.signals.t, found.signals.array("master.q")
    away = np.abs(q - found.system.arms["master"].grip.place).max(axis=1)
    settled = float(t[np.flatnonzero(away > 0.05)[-1] + 1])
    assert said.number == pytest.approx(settled, abs=0.05)
    numbers = {q.name: q for q in analyse(found, tests=False).quantities}
    rate = numbers["approach"]
    assert abs(rate.values[0] - rate.expected[0]) <= rate.error[0] + 0.05 * abs(rate.expected[0])
