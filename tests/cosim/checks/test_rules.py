"""Every rule: a scenario that trips it, with severity and number, and one that does not."""

from __future__ import annotations

import pytest

from cosim.checks import Severity
from cosim.checks.preflight import COMPUTED, NOTES, RULES
from fmus.paper.experiments import network, single, teleoperator
from tests.cosim.checks.cases import (
    CONSTANT,
    VARYING,
    Document,
    changed,
    found,
    heavy_arm,
    rivals,
    tripped,
)

TIGHT = {"k_p": 200.0, "k_d": 2.0, "q_h": [3.5, 3.0]}
NEWEST = {"delay": VARYING, "semantics": "newest-stamp"}
PLAYOUT = {"delay": VARYING, "semantics": "playout"}
QUEUE = {"delay": VARYING, "semantics": "queue", "depth": 20}
OUTAGE = {"law": "outage", "length": 30.0, "every": 100.0}

#: (rule, where, severity, number, tripping document, document that does not trip it)
CASES: list[tuple[str, str, Severity, float, Document, Document]] = [
    # who is reached
    ("root", "robot6", "error", 5.0, network(graphs="tree3", operator=6), network(graphs="tree3")),
    ("spanning-tree", "topology", "warning", 0.0,
     network(schedule={"schedule": [[0.0, "G1"]]}), network()),
    ("unheard", "slave_control.xi_in[0]", "warning", 1.0,
     changed(teleoperator(), ("links", [teleoperator()["links"][0]])),
     changed(teleoperator(), ("links", [teleoperator()["links"][0]]),
             ("components.slave_control.start.w", 0.0))),
    ("stale", "master_control.age", "warning", 0.5,
     changed(teleoperator(), ("components.master_control.start.age_max", 0.5)),
     changed(teleoperator(), ("components.master_control.start.age_max", 0.5),
             ("links.0.age", "master_control.age[0]"))),
    # the law
    ("degenerate", "control", "warning", 2.0, single(lambda_M=2.0),
     single(lambda_M=2.0, z=[0.1, 0.0])),
    ("no-integral", "control", "warning", 0.0, single(lambda_M=0.0), single()),
    ("gravity", "control", "warning", 1.0, heavy_arm((24.525, 11.772), gravity=2),
     heavy_arm((24.525, 11.772))),
    ("constant-delay", "master_control", "warning", 1.2,
     rivals("nuno", VARYING), rivals("nuno", VARYING, semantics="playout", playout=1.2)),
    # links
    ("bounded", "links.slave_control.xi->master_control.xi_in[0]", "warning", 31.21,
     teleoperator(30.0, link=NEWEST | {"loss": OUTAGE}), teleoperator(30.0, link=NEWEST)),
    ("buffer", "links.slave_control.xi->master_control.xi_in[0]", "warning", 22.0,
     teleoperator(link=PLAYOUT | {"playout": 1.0}), teleoperator(link=PLAYOUT | {"playout": 1.2})),
    ("backwards", "links.slave_control.xi->master_control.xi_in[0]", "note", 0.75,
     teleoperator(), teleoperator(link=NEWEST)),
    ("like-a-wire", "links.slave.q->master_control.q_j", "note", 0.0,
     rivals("pd", {"law": "constant", "delay": 0.0}), rivals("pd", CONSTANT)),
    ("queue", "links.master_control.xi->slave_control.xi_in[0]", "warning", 0.75 + 19 * 0.005,
     changed(teleoperator(link=QUEUE), ("components.slave_control.period", 0.01)),
     changed(teleoperator(link=QUEUE | {"take": "all"}),
             ("components.slave_control.period", 0.01))),
    ("queue", "links.master_control.xi->slave_control.xi_in[0]", "note", 2.2,
     teleoperator(link=QUEUE), teleoperator(link=QUEUE | {"depth": 1})),
    # wiring
    ("unfed", "slave.tau", "warning", 2.0,
     changed(teleoperator(), ("components.slave.inputs", None)), teleoperator()),
    ("unfed", "slave.tau", "warning", 2.0,
     changed(teleoperator(), ("components.slave.inputs", None)),
     changed(teleoperator(), ("components.slave.inputs", None),
             ("components.slave.start.tau", 0.0))),
    ("unfed", "master_control.dq[1]", "warning", 1.0,
     changed(teleoperator(), ("components.master_control.inputs",
                              {"q": "master.q", "dq[0]": "master.dq[0]"})), teleoperator()),
    ("jacobi", "run.algorithm", "note", 0.005,
     changed(single(), ("run.algorithm", "jacobi")), single()),
]  # fmt: skip


@pytest.mark.parametrize("case", CASES, ids=[c[0] for c in CASES])
def test_a_rule_speaks_where_it_should_and_only_there(
    case: tuple[str, str, Severity, float, Document, Document],
) -> None:
    rule, where, severity, number, bad, good = case
    said = [f for f in tripped(bad, rule) if where in f.where]
    assert len(said) == 1, [f.line for f in found(bad)]
    assert said[0].severity == severity
    assert said[0].number == pytest.approx(number, rel=0.1)
    assert said[0].reason and (said[0].advice or severity == "note")
    silent = [f for f in tripped(good, rule) if f.severity == severity and where in f.where]
    assert not silent, [f.line for f in silent]


def test_every_rule_is_among_the_cases() -> None:
    """One rule function, one name or more; size, unknown and predictions are tested below."""
    assert {c[0] for c in CASES} >= {
        "root", "spanning-tree", "unheard", "stale", "degenerate", "no-integral", "gravity",
        "constant-delay", "bounded", "buffer", "backwards", "like-a-wire", "queue", "unfed",
        "jacobi",
    }  # fmt: skip
    # those of buses: tests/cosim/scenario/test_buses.py; of FMUs without units: test_unitless.py;
    # of SSPs: tests/ssp/test_published.py; of tips: test_tasks.py;
    # of servos: test_servos.py; of files of robots: tests/fmus/robots/test_urdf.py, cosim/mujoco
    # of plants: tests/cosim/engine/test_plant_loops.py; what is computed: test_loops.py
    # skew: test_receivers.py
    assert len(COMPUTED) + len(RULES) + len(NOTES) == 49


# ---- predictions and the rest -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("document", "numbers"),
    [
        (teleoperator(), {"felt-damping": 4.0, "stiffness": 1.6}),
        (teleoperator(lambda_M=1.0), {"felt-damping": 40.0, "stiffness": 16.0}),
        (teleoperator(link={}), {"felt-damping": 1.6}),
        (teleoperator(link=NEWEST), {"felt-damping": 0.8 * (2 + 2 * 0.95)}),
        (single(), {"felt-damping": 32 / 6}),
        (single(lambda_M=0.0), {"felt-stiffness": 32.0}),
    ],
    ids=["pair", "pair, lambda_M = 1", "no delay", "newest stamp", "single", "no integral"],
)
def test_predictions_are_those_of_the_reading(
    document: Document, numbers: dict[str, float]
) -> None:
    said = {f.rule: f.number for f in found(document)}
    for rule, number in numbers.items():
        assert said[rule] == pytest.approx(number, rel=0.02), rule


def test_gravity_that_nobody_compensates() -> None:
    (said,) = tripped(heavy_arm((0.0, 0.0)), "gravity")
    assert "the arm sags" in said.reason and said.number == pytest.approx(24.525)
    assert tripped(heavy_arm((24.525, 11.772), gravity=0), "gravity")


def test_losses_at_random_are_a_note_while_gaps_are_short() -> None:
    few, many = (
        teleoperator(link=NEWEST | {"loss": {"law": "independent", "p": p}}) for p in (0.05, 0.995)
    )
    assert {f.severity for f in tripped(few, "bounded")} == {"note"}
    assert {f.severity for f in tripped(many, "bounded")} == {"warning"}


def test_waves_want_a_constant_delay() -> None:
    assert tripped(rivals("wave", VARYING), "constant-delay")
    assert not tripped(rivals("wave", CONSTANT), "constant-delay")


def test_the_size_of_what_is_recorded() -> None:
    (said,) = tripped(single(), "size")
    assert said.severity == "note"
    columns, rows = 15, 4001  # q, dq, tau_h, tau, s, z: 2 each, theta_hat 3; and time
    assert said.number == pytest.approx(8 * (columns + 1) * rows / 1e6)
    (large,) = tripped(changed(single(), ("run.stop", 1e6)), "size")
    assert large.severity == "warning"


def test_what_is_not_known_is_said() -> None:
    bare = {
        "run": {"step": 0.01, "stop": 1.0},
        "components": {
            "arm": {"model": "fmus.models.planar2r", "inputs": {"tau": "mine.y"}},
            "mine": {"model": "tests.cosim.checks.components:Nothing"},
        },
    }
    (said,) = tripped(bare, "unknown")
    assert said.where == "mine" and "offers no facts" in said.reason


def test_who_is_held_may_be_said_by_the_scenario() -> None:
    document = changed(network(graphs="tree3"), ("analysis", {"force": "robot5.tau_h"}))
    (said,) = tripped(document, "root")
    assert said.where == "robot5" and said.advice.startswith("hold robot3")


def test_edges_that_never_are_there_reach_nobody() -> None:
    """A weight that stays 0 is no edge, over a wire or over a link."""
    over_wires = changed(network(), ("topology", None))
    for i in range(1, 7):
        over_wires["components"][f"control{i}"]["start"]["w"] = 0.0 if i == 4 else 1.0
    (said,) = tripped(over_wires, "root")
    assert "control4" in said.reason and "control6" in said.reason
    links = teleoperator()
    links["components"]["slave_control"]["start"]["w"] = 0.0
    (said,) = tripped(links, "root")
    assert "never reaches slave_control" in said.reason


# ---- as a whole ---------------------------------------------------------------------------------


def test_findings_come_worst_first_and_once() -> None:
    said = found(teleoperator(grip=TIGHT))
    order = ["error", "warning", "note"]
    assert [f.severity for f in said] == sorted((f.severity for f in said), key=order.index)
    assert said[0].rule == "run"


def test_without_notes_there_are_none() -> None:
    assert {f.severity for f in found(single(lambda_M=0.0), notes=False)} == {"warning"}


def test_nothing_to_complain_about() -> None:
    document = teleoperator(lambda_M=1.0, link=NEWEST, tau_max=100.0)
    assert not [f.line for f in found(document, notes=False)]
