"""Scenes in scenarios and at the command line: what is refused, recorded and printed."""

from __future__ import annotations

import json
import sys

import pytest

from cosim.base.errors import CosimError, MujocoError
from cosim.comparison import documents
from cosim.engine.simulate import simulate
from cosim.loading.files import load
from cosim.mujoco import library
from cosim.record.run import Run
from tests.cli.command import Command
from tests.cosim.mujoco.scenes import ARM, CONFIGS, HINGE
from tests.cosim.scenarios import plan, scenario

SHIPPED = CONFIGS / "teleoperation.toml"


@pytest.mark.parametrize(
    ("spec", "step", "words"),
    [
        ({}, 1.5e-3, "arm.xml has a time step of 0.001 s (option timestep), found a period of"),
        ({"kind": "sampled"}, 1e-3, "found sampled, expected continuous"),
        ({"isolate": True}, 1e-3, "components.arm.isolate: found a key that a scene of MuJoCo"),
        ({"sizes": {"joints": 2}}, 1e-3, "components.arm.sizes: found a key"),
        (
            {"options": {"joint": ["a"]}},
            1e-3,
            "no key 'joint'; did you mean 'joints'?",
        ),
        ({"options": {"joints": ["a"]}}, 1e-3, "no joint 'a' (there are: elbow, shoulder)"),
        ({"options": {"joints": ["elbow"], "groups": {"a": ["elbow"]}}}, 1e-3, "one of the two"),
        ({"start": {"q": [1, 2, 3]}}, 1e-3, "expected shape [2], found 3 entries"),
        ({"start": {"q": ["1 m", "2 rad"]}}, 1e-3, "q[0]"),
        ({"parameters": {"mass": 1}}, 1e-3, "no parameter or start 'mass'"),
        ({"preset": "SL91"}, 1e-3, "no preset 'SL91'"),
        (
            {"inputs": {"tau": "arm.q"}},
            1e-3,
            "units do not fit: arm.q is in [rad], arm.tau expects",
        ),
    ],
)
def test_a_scenario_that_does_not_fit_its_scene_is_refused(spec, step, words):
    with pytest.raises(CosimError) as error:
        plan({"arm": {"model": f"mujoco:{ARM}", **spec}}, step=step, stop=step * 10)
    assert words in str(error.value)
    assert "components.arm" in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "scene.xml does not exist; expected an MJCF or URDF file"),
        ("<mujoco><worldbody><geom type='foo'/></worldbody></mujoco>", "invalid keyword: 'foo'"),
        ("<mujoco", "scene.xml: "),
        (HINGE.replace('name="j"', 'name="j" typ="hinge"'), "unrecognized attribute: 'typ'"),
    ],
)
def test_a_file_that_mujoco_does_not_accept_is_refused(tmp_path, text, words):
    if text is not None:
        (tmp_path / "scene.xml").write_text(text)
    with pytest.raises(MujocoError) as error:
        plan({"arm": {"model": f"mujoco:{tmp_path}/scene.xml"}})
    assert words in str(error.value) and "\n" not in str(error.value)
    assert "components.arm.model" in str(error.value)


def test_without_mujoco_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    library.package.cache_clear()
    try:
        with pytest.raises(MujocoError, match=r"pip install 'cosim-bridge\[mujoco\]'"):
            plan({"arm": {"model": f"mujoco:{ARM}"}}, step=1e-3)
    finally:
        library.package.cache_clear()


def test_a_run_records_scenes_and_version(tmp_path):
    made = scenario(
        {"arm": {"model": f"mujoco:{ARM.name}", "start": {"tau": [1.0, 2.0]}}},
        path=str(CONFIGS / "test.toml"), step=1e-3, stop=0.01,
    )  # fmt: skip
    simulate(made, tmp_path / "run")
    facts = json.loads((tmp_path / "run" / "run.json").read_text())["simulators"]["arm"]
    assert facts["file"] == str(ARM) and facts["step"] == "0.001 s"
    assert facts["simulator"].startswith("MuJoCo ") and facts["integrator"] == "RK4"
    assert len(facts["sha256"]) == len(facts["compiled_sha256"]) == 64
    assert "includes" not in facts and facts["sha256"] != facts["compiled_sha256"]


def test_the_shipped_teleoperation_touches_the_wall(tmp_path):
    made = load(SHIPPED, ["run.stop=4"])
    assert simulate(made, tmp_path / "run").ticks == 4000
    run = Run.open(tmp_path / "run")
    force, tip = run.column("slave.contact_force[1]"), run.column("slave.x_tip[1]")
    assert force[:1000].max() == 0.0 and force.max() > 10.0 and force[-1] > 0.1
    assert 1.455 < tip.max() < 1.47


# ---- commands -------------------------------------------------------------------------------


def test_info_prints_ports_and_units(cosim: Command) -> None:
    done = cosim("info", f"mujoco:{CONFIGS / 'wall.xml'}")
    assert (done.code, done.err) == (0, "")
    rows = [line.split() for line in done.out.splitlines()]
    assert ["tau[2]", "input", "N.m", "Torque", "of", "the", "motors"] in rows
    assert ["contact_force[3]", "output", "N", "Sensor:", "contact"] in rows
    assert ["integrator", "IMPLICITFAST"] in rows and ["gravity", "0", "0", "0", "m/s2"] in rows


def test_info_of_a_missing_scene_is_one_sentence(cosim: Command) -> None:
    assert "nothing.xml does not exist; expected an MJCF" in cosim.refused(
        "info", "mujoco:nothing.xml"
    )


def test_show_and_check_know_a_scene(cosim: Command) -> None:
    assert "wall.xml, MuJoCo " in cosim("show", SHIPPED).out
    done = cosim("check", SHIPPED)
    assert done.code == 0 and "0 errors, 0 warnings" in done.out


@pytest.mark.slow
def test_a_rehearsal_with_scenes_replays_exactly(cosim: Command, tmp_path) -> None:
    done = cosim(
        *("rehearse", SHIPPED, "--deploy", CONFIGS.parent / "deploy" / "can.toml", "-i", "cosim"),
        *("--clock", "simulated", "--set", "run.stop=0.5", "--no-plot"),
        *("--set", 'deploy.nodes.master.components=["master","hand"]', "--out", tmp_path / "r"),
    )
    assert done.code == 0, done
    assert "computed again: difference exactly 0" in done.out


def test_an_ssp_does_not_hold_a_scene(cosim: Command) -> None:
    said = cosim.refused("export", SHIPPED, "--ssp", "out.ssp")
    assert "components.master.model: found a scene of MuJoCo, which an SSP does not hold" in said


def test_the_scene_of_a_variant_is_relative_to_its_file(tmp_path) -> None:
    assert documents._model("mujoco:a/b.xml", tmp_path) == f"mujoco:{tmp_path}/a/b.xml"


@pytest.mark.slow
def test_controllers_are_compared_at_the_wall(cosim: Command, tmp_path) -> None:
    done = cosim(
        *("compare", SHIPPED, "--controllers", "paper,wave", "--links", "lan", "--no-plot"),
        *("--out", tmp_path / "table"),
    )
    assert done.code == 0, done
    table = json.loads((tmp_path / "table" / "table.json").read_text())
    found = {run["controller"]: run["numbers"] for run in table["runs"]}
    assert all(values["impact"] > 10.0 and values["rest"] > 0.1 for values in found.values())
    assert found["wave"]["position"] < found["paper"]["position"]
