"""OpenArm over a table: the scene is written from the URDF and moves as the arm of the project."""

from __future__ import annotations

from runpy import run_path

import numpy as np

from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.mujoco import MujocoOptions
from cosim.mujoco.component import MujocoComponent
from cosim.record import Run
from fmus.models import arm
from tests.cosim.mujoco.scenes import CONFIGS

SCENE = CONFIGS / "openarm.xml"
WRITE = run_path(str(CONFIGS / "write.py"))
URDF = {"urdf": "robots/openarm_right.urdf", "base": "body", "tip": "hand"}


def test_the_scene_is_written_from_the_urdf():
    assert SCENE.read_text(encoding="utf-8") == WRITE["write"]()


def test_openarm_moves_as_the_arm_of_the_project():
    """Both by the method of Runge and Kutta of order 4 with 1 ms, far from table and limits."""
    scene = MujocoComponent(SCENE, MujocoOptions(outputs=("q", "dq")))
    scene.scene.model.opt.integrator = 1
    prepared = arm.prepare(URDF, CONFIGS.parent)
    kernel = arm.kernel(**prepared.sizes)
    extra = {"armature": np.array(WRITE["ARMATURE"]), "damping": np.array(WRITE["DAMPING"])}
    start = {"q": np.array([0.2, 0.5, -0.1, 1.2, 0.1, 0.0, 0.2]), "dq": np.full(7, 0.3)}
    kernel.initialize({k: np.array(v) for k, v in prepared.values.items()} | extra | start)
    scene.initialize(start)
    u = {"tau": np.array([3.0, 3.0, 1.0, 3.0, 0.2, 0.1, 0.3])}
    kernel.initial(u), scene.initial(u)
    for k in range(200):
        ours, theirs = (x.step(k * 1e-3, 1e-3, u) for x in (scene, kernel))
    assert np.abs(ours["q"] - start["q"]).max() > 0.05
    assert np.abs(ours["q"] - theirs["q"]).max() < 1e-12
    assert np.abs(ours["dq"] - theirs["dq"]).max() < 1e-12


def test_the_slave_touches_the_table(tmp_path):
    made = load(CONFIGS / "openarm.toml", ["run.stop=1.2", "run.record.every=1"])
    simulate(made, tmp_path / "run")
    run = Run.open(tmp_path / "run")
    force, height = run.column("slave.table_force[2]"), run.column("slave.x_tcp[2]")
    assert np.abs(force[:500]).max() == 0.0 and force.min() < -1.0
    assert 0.31 < height.min() < 0.32
