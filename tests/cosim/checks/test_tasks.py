"""Rules about laws in the coordinates of tips: scenarios that trip one, and their bounds."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from cosim.checks.preflight import check
from cosim.predict.facts import Arm, DynamicFeedback
from cosim.predict.system import system
from cosim.scenario.assemble import assemble
from cosim.scenario.spec import build
from tests.cosim.checks.cases import Document, changed

SHIPPED = Path(__file__).parents[3] / "configs" / "task_space.toml"
CONTROL = "components.master_control.parameters"


@pytest.fixture(scope="module")
def shipped() -> Document:
    """Three arms of 7, 6 and 2 joints."""
    document: Document = tomllib.loads(SHIPPED.read_text(encoding="utf-8"))
    return document


def said(document: Document) -> dict[str, list[tuple[str, str, float]]]:
    """Of each rule where, how bad and how much."""
    scenario = build(document, SHIPPED)
    found: dict[str, list[tuple[str, str, float]]] = {}
    for finding in check(scenario, assemble(scenario)):
        found.setdefault(finding.rule, []).append((finding.where, finding.severity, finding.number))
    return found


def test_tips_that_touch_nothing_are_checked_as_well() -> None:
    path = SHIPPED.parent / "robots" / "turn.toml"
    scenario = build(tomllib.loads(path.read_text(encoding="utf-8")), path)
    found = {f.rule for f in check(scenario, assemble(scenario))}
    assert "stiffness" in found


def test_the_shipped_scenario_is_only_noted(shipped: Document) -> None:
    found = said(shipped)
    assert found.keys() == {"size", "backwards", "stiffness", "delay-margin"}
    # K_x lambda alpha/lambda_M, and what the joints' K adds
    assert [where for where, *_ in found["stiffness"]] == [
        "master_control", "planar_control", "slave_control",
    ]  # fmt: skip
    assert 60 * 0.05 < found["stiffness"][2][2] < 60 * 0.05 * 1.05
    assert {severity for several in found.values() for _, severity, _ in several} == {"note"}


def test_every_rule_of_tips_speaks_where_it_should(shipped: Document) -> None:
    straight = "components.planar.start.q"
    bad = changed(
        shipped,
        (f"{CONTROL}.listens", [[1, 1, 1], [1, 1, 1]]),
        (f"{CONTROL}.lambda_M", 50.0),
        (f"{CONTROL}.k_n", 0.0),
        ("components.slave_control.parameters.listens", [[1, 0, 1], [1, 0, 0]]),
        ("components.planar_control.parameters.listens", [[1, 0, 1], [1, 0, 1]]),
        ("components.slave_control.parameters.K_x", 9000.0),
        (straight, [0.3, 0.0]),
    )
    found = said(bad)
    assert found["lacks"] == [("master_control", "warning", 2.0)]
    assert found["null-motion"] == [("master_control", "note", 4.0)]
    ((where, severity, share),) = found["singular"]
    assert (where, severity, share < 0.01) == ("planar_control", "warning", True)
    ((where, severity, number),) = found["passivity"]
    assert (where, severity) == ("master_control", "warning")
    assert number < -30
    # The slave and the planar arm do not listen to y; the master does, so it cannot lead or follow.
    assert [n for _, _, n in found["spanning-tree"]] == [1.0]
    ((where, severity, share),) = found["saturation"]  # K_x is too high for the period
    assert (where, severity) == ("slave_control", "warning") and share > 50


def test_without_a_neighbour_that_is_heard_there_is_no_spanning_tree(shipped: Document) -> None:
    deaf = [("components.slave_control.parameters.listens", [[1, 1, 0], [1, 1, 0]]),
            (f"{CONTROL}.listens", [[1, 1, 0], [1, 1, 0]])]  # fmt: skip
    assert [n for _, _, n in said(changed(shipped, *deaf))["spanning-tree"]] == [2.0]
    assert "spanning-tree" not in said(changed(shipped, deaf[0]))  # the master follows the slave


def test_the_passive_limit_is_that_of_the_port_of_the_tip(shipped: Document) -> None:
    """The real part of its admittance at a high frequency changes its sign there."""
    scenario = build(shipped, SHIPPED)
    known = system(scenario, assemble(scenario))
    law, arm = known.facts["slave_control"], known.facts["slave"]
    assert isinstance(law, DynamicFeedback)
    assert isinstance(arm, Arm)
    assert law.task is not None
    M, J = arm.inertia(arm.parameters, arm.q), law.task.jacobian(arm.q)
    B, p = law.task.feedback(arm.q) + np.diag(arm.friction), 1e4j

    coupled = law.lambda_ * known.received_weight("slave_control")
    assert coupled > 0

    def least(lambda_M: float) -> float:
        Y = (p + lambda_M) / (p + law.alpha) * (J @ np.linalg.inv(M * p + B) @ J.T)
        Y = p / (p + coupled) * Y  # what the tip hears from its neighbour comes back later
        return float(np.linalg.eigvalsh(Y + Y.conj().T)[0])

    setting = "components.slave_control.parameters.lambda_M"
    ((_, _, margin),) = said(changed(shipped, (setting, 1000.0)))["passivity"]
    limit = 1000.0 + margin
    assert least(0.99 * limit) > 0 > least(1.01 * limit)


def test_a_stiff_contact_that_is_sampled_slowly_makes_energy(shipped: Document) -> None:
    """K T/2 against the damping of the wall and of the arm, at least K_x N.s/m."""
    wall = ("components.hand.parameters.k_w", 2e5)
    ((where, severity, number),) = said(changed(shipped, wall))["hand"]
    assert (where, severity) == ("hand", "warning")
    assert number == pytest.approx(2e5 * 1e-3 / 2)
    damped = ("components.hand.parameters.b_w", 41.0)  # with the 60 N.s/m of the arm
    assert "hand" not in said(changed(shipped, wall, damped))
    less = ("components.hand.parameters.b_w", 20.0)
    assert "hand" in said(changed(shipped, wall, less))
