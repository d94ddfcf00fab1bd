"""Arms that are meant to agree stand in one workspace, and each of the others by itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cosim.base.component import Drawing, SharedBase
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.record import Run
from cosim.reporting.arms import DrawnArm, first_arms, in_workspace, in_workspaces, points
from fmus.models import arm_task, planar2r

CONFIGS = Path(__file__).parents[3] / "configs"
PLANAR = planar2r.drawing({}, Path())
OTHER = Drawing((False,), ((1.0, 0, 0, 0, 1, 0, 0, 0, 1),), ((0.0, 0, 0),), (1.0, 0, 0))
TASK: dict[str, Any] = {"model": "fmus.models.arm_task", "parameters": {"scale": 0.5}}


def facts(metric: dict[str, Any] | None = None, links: tuple[str, ...] = ()) -> dict[str, Any]:
    """``run.json`` of two arms, each with a controller."""
    laws = {f"law_{name}": {"inputs": {"q": f"{name}.q"}} for name in "ab"}
    components = {"a": {}, "b": {}, **laws}
    metrics = {"m": metric} if metric else {}
    scenario = {"components": components, "metrics": metrics}
    return {"scenario": scenario, "links": dict.fromkeys(links)}


def workspaces(a: Drawing, b: Drawing, said: dict[str, Any]) -> list[int]:
    arms = [DrawnArm(name, drawing, {}, Path()) for name, drawing in (("a", a), ("b", b))]
    return [arm.workspace for arm in in_workspaces(arms, said)]


@pytest.mark.parametrize(
    ("metric", "links", "expected"),
    [
        (None, (), [0, 1]),
        ({"kind": "error", "of": ["a.q"], "target": "b.q"}, (), [0, 0]),
        ({"kind": "error", "of": ["law_a.x", "b.x"], "target": [0.0]}, (), [0, 0]),
        ({"kind": "error", "of": ["a.q"], "target": [0.0]}, (), [0, 1]),
        ({"kind": "peak", "of": ["a.q", "b.q"]}, (), [0, 1]),
        (None, ("law_a.xi->law_b.xi_in[0]",), [0, 0]),
        (None, ("a.q->law_a.q",), [0, 1]),
    ],
)
def test_equal_arms_that_agree_stand_on_one_base(
    metric: Any, links: tuple[str, ...], expected: list[int]
) -> None:
    assert workspaces(PLANAR, PLANAR, facts(metric, links)) == expected
    assert workspaces(PLANAR, OTHER, facts(metric, links)) == [0, 1]


def test_arms_that_differ_need_controllers_with_common_coordinates() -> None:
    said = facts(links=("law_a.xi->law_b.xi_in[0]",))
    said["scenario"]["components"]["law_a"] |= TASK
    assert workspaces(PLANAR, OTHER, said) == [0, 1]
    said["scenario"]["components"]["law_b"] |= TASK
    assert workspaces(PLANAR, OTHER, said) == [0, 0]
    said["links"] = {}
    assert workspaces(PLANAR, OTHER, said) == [0, 1]


def test_tips_are_where_the_controllers_have_them(tmp_path: Path) -> None:
    """Controllers in C compute x of their tips; the base of each arm is where this is its tip."""
    settings = ("run.stop=0.2", "run.record.every=100")
    simulate(load(CONFIGS / "task_space.toml", settings), tmp_path / "run")
    run = Run.open(tmp_path / "run")
    arms, _ = first_arms(run)
    assert {arm.workspace for arm in arms} == {0} and len(arms) == 3
    for arm in arms:
        for row, q in enumerate(run.array(f"{arm.name}.q")[:-1]):
            tip = in_workspace(arm.base, points(arm.drawing, q))[-1]
            assert tip == pytest.approx(run.array(f"{arm.name}_control.x")[row], abs=1e-6)


def test_bases_of_fewer_coordinates() -> None:
    two = arm_task.shared_base(
        {}, {"frame": [[0, 1, 0], [-1, 0, 0]], "x_0": ["10 cm", 0, 0]}, Path()
    )
    assert two is not None and two.origin == (0.1, 0.0, 0.0)
    assert np.linalg.det(np.reshape(two.rotation, (3, 3))) == pytest.approx(1.0)
    assert arm_task.shared_base({}, {"frame": [[1, 0, 0]]}, Path()) is None
    assert in_workspace(SharedBase(scale=2.0), np.ones((1, 3))).tolist() == [[2.0, 2.0, 2.0]]
