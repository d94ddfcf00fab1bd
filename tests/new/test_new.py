"""``cosim new``: what it writes runs, is rehearsed and passes its test as it is."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer import Typer
from typer.testing import CliRunner

from bridge.can.codec import Codec
from bridge.cli.new import _held, new
from bridge.deployment.system import load_system
from bridge.results.outcome import run_twin
from bridge.scaffold import write_arm, write_controller
from cosim.base.errors import CosimError, ScenarioError
from cosim.cli.export import export
from cosim.cli.options import flat
from cosim.cli.summary import check
from cosim.engine.simulate import columns, simulate
from cosim.loading.files import load
from cosim.measure import declared_metrics
from cosim.measure.metrics import evaluate
from cosim.record import Run
from cosim.scenario.assemble import assemble
from cosim.schedule.parts import Wire
from tests.cli.command import CALL

ROOT = Path(__file__).resolve().parents[2]
ROBOTS = ROOT / "configs" / "robots"
_PATHS = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
ENVIRONMENT = os.environ | {"PYTHONPATH": _PATHS}


def test_the_scenario_runs_and_the_arm_arrives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, scenario, *_ = write_controller("law_that_runs", tmp_path)
    assert len(module.read_text().splitlines()) < 30
    monkeypatch.syspath_prepend(str(tmp_path))
    result = Run.open(simulate(load(scenario), tmp_path / "run").folder)
    assert abs(result.array("arm.q")[-1, 0] - 0.698) < 0.01


def test_its_test_passes_in_a_new_interpreter(tmp_path: Path) -> None:
    write_controller("law", tmp_path)
    call = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_law.py"]
    done = subprocess.run(
        call,
        cwd=tmp_path,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout  # alone, and with frames on a bus


@pytest.mark.slow
def test_it_is_rehearsed_as_it_is(tmp_path: Path) -> None:
    write_controller("law", tmp_path)
    call = [*CALL, "rehearse", "law.toml", "--out", "run", "--clock"]
    done = subprocess.run(
        [*call, "simulated"], cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "verdict                passed: every node finished" in done.stdout


@pytest.mark.parametrize(
    ("file", "ends"),
    [("six_axis", ("", "")), ("openarm_right", ("body", "hand")), ("fr3", ("", ""))],
)
def test_two_arms_of_a_file_come_together(tmp_path: Path, file: str, ends: tuple[str, str]) -> None:
    paths, missing = write_arm("arm", ROBOTS / f"{file}.urdf", tmp_path, *ends)
    names = [str(path.relative_to(tmp_path)) for path in paths]
    assert names == ["arm.toml", "test_arm.py", "deploy/arm.toml", "can/arm.dbc"] and not missing
    scenario = load(paths[0])
    run = Run.open(simulate(scenario, tmp_path / "run").folder)
    apart = run.array("slave.q") - run.array("master.q")
    assert np.abs(apart[-1]).max() < 0.02
    moved = np.abs(run.array("master.q")[-1] - run.array("master.q")[0])
    assert moved.max() > 0.2  # the operator has moved it
    system = load_system(paths[0], str(paths[2]), ["run.stop='0.2 s'"])
    assert set(system.nodes) == {"master", "slave", "master_control", "slave_control"}
    twin = Run.open(run_twin(system, tmp_path / "twin"))
    early = run.array("master.q")[: len(twin)]
    assert np.abs(twin.array("master.q")[-1] - early[-1]).max() < 0.02


def test_an_arm_without_a_bus_says_why(tmp_path: Path) -> None:
    paths, missing = write_arm("arm", gantry(tmp_path, *["revolute"] * 8), tmp_path)
    assert [path.name for path in paths] == ["arm.toml", "test_arm.py"]
    assert missing == "a frame has room for 7 of 8 joints"


def test_an_arm_with_several_ends_names_them(tmp_path: Path) -> None:
    text = (ROBOTS / "six_axis.urdf").read_text(encoding="utf-8")
    camera = (
        '<link name="camera"/><joint name="j_camera" type="fixed"><parent link="link3"/>'
        '<child link="camera"/></joint></robot>'
    )
    urdf = tmp_path / "camera.urdf"
    urdf.write_text(text.replace("</robot>", camera), encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"may end in camera, .*; expected --tip"):
        write_arm("arm", urdf, tmp_path)
    write_arm("arm", urdf, tmp_path, tip="link6")


@pytest.mark.parametrize("name", ["2nd", "my-law", "", "a/b"])
def test_what_is_no_module_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ScenarioError, match="is not a valid name of a Python module"):
        write_controller(name, tmp_path)
    assert not list(tmp_path.iterdir())


def test_nothing_is_written_over(tmp_path: Path) -> None:
    (tmp_path / "test_law.py").write_text("mine")
    with pytest.raises(ScenarioError, match="exists already"):
        write_controller("law", tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["test_law.py"]


def test_the_commands_say_what_they_wrote(tmp_path: Path) -> None:
    app = Typer()
    app.command("new")(flat(new))
    app.command("export")(flat(export))
    runner = CliRunner()
    done = runner.invoke(app, ["new", "controller", "law", "--dir", str(tmp_path)])
    assert done.exit_code == 0
    assert "cosim run law.toml" in done.output
    config, out = ROOT / "configs" / "teleoperation.toml", tmp_path / "t.ssp"
    done = runner.invoke(app, ["export", str(config), "--ssp", str(out)])
    assert done.exit_code == 0, done.exception
    assert f"{out}  4 FMUs, 2 links" in done.output
    assert isinstance(runner.invoke(app, ["export", str(config)]).exception, ScenarioError)
    for wrong in (["plant", "x"], ["arm", "x"], ["controller", "x", "--tip", "hand"]):
        assert isinstance(runner.invoke(app, ["new", *wrong]).exception, ScenarioError)
    file = str(ROBOTS / "six_axis.urdf")
    done = runner.invoke(app, ["new", "arm", "mine", "--urdf", file, "--dir", str(tmp_path)])
    assert done.exit_code == 0 and "cosim rehearse mine.toml" in done.output


GANTRY = """<robot name="gantry"><link name="base"/>{links}{joints}</robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="0.05 0 0.02"/><mass value="{mass}"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0.1 0 0.1"/><axis xyz="{axis}"/>
<limit lower="-0.4" upper="0.4" effort="{effort}" velocity="1"/>{more}</joint>"""


def gantry(folder: Path, *kinds: str, finger: str = "") -> Path:
    """A URDF file of a chain of joints of these kinds; `finger`: one more on the last link."""
    folder.mkdir(exist_ok=True)
    links = [LINK.format(name=f"l{i}", mass=9 - i) for i in range(len(kinds))]
    joints = [
        JOINT.format(
            name=f"j{i}", kind=kind, parent=f"l{i - 1}" if i else "base", child=f"l{i}",
            axis=("1 0 0", "0 1 0", "0 0 1")[i % 3], effort=200, more="",
        )
        for i, kind in enumerate(kinds)
    ]  # fmt: skip
    if finger:
        links.append(LINK.format(name="finger", mass=0.1))
        joints.append(
            JOINT.format(
                name="grip", kind="prismatic", parent=f"l{len(kinds) - 1}", child="finger",
                axis="0 1 0", effort=20, more=finger,
            )
        )  # fmt: skip
    path = folder / "gantry.urdf"
    path.write_text(GANTRY.format(links="".join(links), joints="".join(joints)))
    return path


def simulated(paths: list[Path], folder: Path) -> Run:
    return Run.open(simulate(load(paths[0]), folder / "run").folder)


@pytest.mark.parametrize(
    ("kinds", "metrics", "units"),
    [
        (
            ("prismatic", "prismatic", "prismatic"),
            {"together_sliding": "m", "peak_force": "N"},
            ["m", "m", "m"],
        ),
        (
            ("revolute", "prismatic", "revolute"),
            {"together": "rad", "peak_torque": "N.m", "together_sliding": "m", "peak_force": "N"},
            ["rad", "m", "rad"],
        ),
    ],
)
def test_what_slides_is_measured_in_m_and_apart_from_angles(
    tmp_path: Path, kinds: tuple[str, ...], metrics: dict[str, str], units: list[str]
) -> None:
    paths, missing = write_arm("arm", gantry(tmp_path, *kinds), tmp_path)
    assert not missing
    run = simulated(paths, tmp_path)
    assert [run.units[f"master.q[{i}]"] for i in range(3)] == units
    forces = ["N" if unit == "m" else "N.m" for unit in units]
    assert [run.units[f"master_control.tau[{i}]"] for i in range(3)] == forces
    assert [run.units[f"master_control.xi_in[0,{i}]"] for i in range(3)] == [
        f"{unit}/s" for unit in units
    ]
    found = {r.name: r for r in evaluate(declared_metrics.metrics(load(paths[0])), run)}
    assert {name: r.unit for name, r in found.items()} == metrics
    for name, r in found.items():
        assert "settle_s" not in r.parts or r.parts["settle_s"] < 15.0, name
    apart = np.abs(run.array("slave.q") - run.array("master.q"))
    slides = [unit == "m" for unit in units]
    assert found["together_sliding"].parts["max"] == pytest.approx(apart[:, slides].max())


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The scenario of two arms whose first joint turns and whose second slides."""
    folder = tmp_path_factory.mktemp("slider")
    return write_arm("arm", gantry(folder, "revolute", "prismatic"), folder)[0][0]


def test_start_values_of_a_joint_have_its_unit(slider: Path) -> None:
    def start(text: str) -> dict[str, tuple[float, ...]]:
        plan = assemble(load(slider, [f"components.master.{text}"]))
        return dict(next(c for c in plan.components if c.name == "master").values)

    assert start('start.q=["9 deg", "100 mm"]')["q"] == pytest.approx((math.pi / 20, 0.1))
    assert start('start={"q[1]" = "50 mm"}')["q"] == (0.0, 0.05)
    assert start('parameters.k_d=["2 N.m.s/rad", "3 N.s/m"]')["k_d"] == (2.0, 3.0)
    for wrong in ("['1 mm', 0]", "[0, '5 deg']", "'5 deg'"):
        with pytest.raises(ScenarioError, match=r"start\.q.*cannot feed \[(m|rad)\]"):
            start(f"start.q={wrong}")
    with pytest.raises(ScenarioError, match=r"start\.q\[1\]: \[deg\] cannot feed \[m\]"):
        start('start={"q[1]" = "5 deg"}')


def test_connections_of_joints_have_their_units(slider: Path) -> None:
    folder = slider.parent
    document = load(slider, [])
    other = gantry(folder / "other", "prismatic", "revolute")
    assert assemble(document)
    with pytest.raises(
        ScenarioError, match=r"tau\[0\] is in \[N.m\], slave.tau\[0\] expects \[N\]"
    ):
        assemble(load(slider, [f"components.slave.options.urdf={other}"]))


def test_a_number_of_one_component_fits_the_joint_that_it_feeds(
    slider: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(slider.parent))
    (slider.parent / "hands.py").write_text(
        "import cosim\n"
        + "".join(
            f'@cosim.component(outputs={{"f": "{unit}"}}, inputs={{}})\n'
            f"def {name}():\n    return {{'f': 2.0}}\n"
            for name, unit in (("force", "kN"), ("torque", "N.m"))
        )
    )

    def fed(name: str, entry: int) -> Wire:
        hand = f'components.hand={{model="hands:{name}", period="4 ms"}}'
        wire = f'components.master.inputs={{tau="master_control.tau", "tau_ext[{entry}]"="hand.f"}}'
        plan = assemble(load(slider, [hand, wire]))
        return next(w for w in plan.wires if w.source.component == "hand")

    assert fed("force", 1).gain == 1000.0 and fed("torque", 0).gain == 1.0
    for name, entry in (("force", 0), ("torque", 1)):
        with pytest.raises(ScenarioError, match=rf"units do not fit: hand.f .*\[{entry}\] expects"):
            fed(name, entry)


def test_a_metric_of_angles_and_lengths_is_refused(tmp_path: Path) -> None:
    paths, _ = write_arm("arm", gantry(tmp_path, "revolute", "prismatic"), tmp_path)
    both = ["metrics.both={kind='error', of=['slave.q'], target='master.q'}"]
    with pytest.raises(ScenarioError, match=r"q\[0\] is in \[rad\] but .*q\[1\] is in \[m\].*name"):
        check(load(paths[0], both), columns(assemble(load(paths[0]))))


@pytest.mark.slow
def test_arms_that_slide_have_a_deployment(tmp_path: Path) -> None:
    paths, _ = write_arm("arm", gantry(tmp_path, "revolute", "prismatic"), tmp_path)
    system = load_system(paths[0], str(paths[2]), ["run.stop=2"])
    layout = next(m for m in system.messages.values() if m.name == "STATE_1").encoding
    assert isinstance(layout, Codec)
    assert [s.unit for s in layout.signals] == ["rad", "m", "rad/s", "m/s"]
    run = Run.open(run_twin(system, tmp_path / "twin"))
    assert run.units["slave.q[1]"] == "m" and np.abs(run.array("slave.q")[-1, 1]) < 0.4


def test_joints_besides_the_arm_are_held(tmp_path: Path) -> None:
    urdf = gantry(tmp_path, "revolute", finger='<mimic joint="j0"/>')
    with pytest.raises(ScenarioError, match=r"--fixed grip=0"):
        write_arm("arm", urdf, tmp_path, tip="l0")
    with pytest.raises(ScenarioError, match=r"mimics the joint 'j0'.*--fixed grip=0"):
        write_arm("arm", urdf, tmp_path, tip="finger")
    paths, _ = write_arm("arm", urdf, tmp_path, tip="l0", fixed={"grip": 0.01})
    assert 'fixed = {"grip" = 0.01}' in paths[0].read_text()
    assert simulated(paths, tmp_path).array("slave.q").shape[1] == 1


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("numpy", "is a Python module already"),
        ("test", "is a Python module already"),
        ("cosim", "is a Python module already"),
        ("bridge", "is a Python module already"),
        ("class", "is a word of Python"),
        ("match", "is a word of Python"),
        ("conftest", "is read by pytest"),
        ("my law", "is not a valid name"),
    ],
)
def test_a_controller_hides_no_module(tmp_path: Path, name: str, says: str) -> None:
    with pytest.raises(ScenarioError, match=f"'{name}' {says}.* e.g. my_law"):
        write_controller(name, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("grip", "expected JOINT=VALUE"),
        ("grip=1Nm", "'1Nm'"),
        ("grip=1 Nm", "'N.m'"),
        ("grip=1 rad", r"'grip', which slides, .*\[rad\] cannot feed \[m\]"),
        ("j0=1 mm", r"'j0', which turns, .*\[mm\] cannot feed \[rad\]"),
    ],
)
def test_values_of_held_joints_have_a_unit_that_fits_or_none(
    tmp_path: Path, given: str, says: str
) -> None:
    urdf = gantry(tmp_path, "revolute", finger='<mimic joint="j0"/>')
    with pytest.raises(CosimError, match=says):
        write_arm("arm", urdf, tmp_path, tip="l0", fixed=_held([given]))
    assert _held(["grip=10 mm", "j=5"]) == {"grip": "10 mm", "j": 5.0}


def test_a_scenario_is_no_urdf(tmp_path: Path) -> None:
    scenario = ROOT / "configs" / "teleoperation.toml"
    with pytest.raises(ScenarioError, match=r"n.toml: is a scenario; .*; expected a URDF file"):
        write_arm("arm", scenario, tmp_path)
