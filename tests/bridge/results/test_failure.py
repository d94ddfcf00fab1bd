"""The failure of a component in a rehearsal: what counts as one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Statement
from bridge.results.rehearsal_outcome import failure_of
from bridge.results.report import NodeReport

NODES = {"left": SimpleNamespace(components=("arm",)), "right": SimpleNamespace(components=("b",))}
SYSTEM = SimpleNamespace(deployment=SimpleNamespace(nodes=NODES))
DIVERGED = "arm: doStep returned discard at tick 830"


def failure(*lives: tuple[str, int, LifeEnd, str, float]):
    """`lives`: (node, boot, end, error, the time of the last slot, s)."""
    reports, rows = [], {}
    for node, boot, end, error, last in lives:
        life = Life(node, boot)
        statement = Statement(life=life, end=end, error=error)
        reports.append(NodeReport(life, 3, None, "active", (), statement))
        slots = np.zeros(3, [("deadline_ns", np.int64)])
        slots["deadline_ns"] = np.array([0.0, 0.5, 1.0]) * last * 1e9
        rows[life] = slots
    return failure_of(SYSTEM, rows, reports)


def test_the_first_component_that_fails() -> None:
    found = failure(
        ("left", 1, LifeEnd.FAILED, DIVERGED, 0.83), ("right", 1, LifeEnd.FAILED, "b: full", 0.9)
    )
    assert found is not None and found.why == DIVERGED and found.t == pytest.approx(0.83)


@pytest.mark.parametrize(
    "lives",
    [
        [("left", 1, LifeEnd.FINISHED, "", 1.0)],
        [("left", 1, LifeEnd.FAILED, "receives nothing from b.q", 0.8)],
        [("left", 1, LifeEnd.FAULT, DIVERGED, 0.8)],
        [("left", 1, LifeEnd.FAILED, DIVERGED, 0.8), ("left", 2, LifeEnd.FINISHED, "", 1.0)],
    ],
    ids=["none", "network", "guard", "started again"],
)
def test_other_ends_are_no_failure_of_a_component(lives) -> None:
    assert failure(*lives) is None
