"""The example that shows a run in MuJoCo's viewer: everything but the window."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from cosim.engine.simulate import simulate
from cosim.record import Run
from tests.cosim.mujoco.scenes import MANY
from tests.cosim.scenarios import scenario

_FILE = Path(__file__).parents[3] / "examples" / "view_mujoco.py"


def test_a_recorded_scene_takes_the_poses_of_the_run(tmp_path):
    spec = importlib.util.spec_from_file_location("view_mujoco", _FILE)
    assert spec is not None and spec.loader is not None
    view = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(view)
    (tmp_path / "many.xml").write_text(MANY)
    arm = {
        "model": "mujoco:many.xml",
        "options": {"groups": {"left": ["left_*"], "rest": ["right_*"]}, "keyframe": "home"},
        "start": {"tau_left": [1.0, -2.0]},
    }
    made = scenario({"arm": arm}, path=str(tmp_path / "test.toml"), step=2e-3, stop=0.2)
    simulate(made, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    shown = view.component(run, "arm")
    times = []
    for t in view.poses(run, shown, "arm", 50.0):
        row = round(t / 2e-3)
        assert shown.data.qpos[:3].tolist() == run.array("arm.x_box")[row].tolist()
        assert shown.data.joint("left_2").qpos[0] == run.column("arm.q_left[1]")[row]
        times.append(t)
    assert times == pytest.approx([0.02 * k for k in range(11)])
    with pytest.raises(SystemExit, match="no scene 'hand'; the run has: arm"):
        view.component(run, "hand")
