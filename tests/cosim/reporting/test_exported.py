"""Runs as files of other tools: the same numbers, and in MCAP arms that move as they did."""

from __future__ import annotations

import json
import os
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat, savemat

from cosim.base.errors import RunError, ScenarioError
from cosim.record import Column, Run
from cosim.record.groups import GroupWriter
from cosim.reporting import exported, matlab
from cosim.reporting.arms import drawn_arms, link_frames, points
from cosim.reporting.exported import FORMATS, export_run, quaternion
from cosim.reporting.moving import RATE, SIZE, pixels
from fmus.arms.serial import serial
from tests.children import fork
from tests.cli.command import Command
from tests.cli.conftest import cosim as cosim  # the command as a fixture
from tests.system.runs import run as simulated
from tests.system.runs import teleoperation

ROOT = Path(__file__).parents[3]
URDF = ROOT / "configs" / "robots" / "openarm_right.urdf"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Half a second of two OpenArms."""
    from cosim.engine.simulate import simulate
    from cosim.loading.files import load

    folder = tmp_path_factory.mktemp("run") / "run"
    simulate(load(ROOT / "configs" / "openarm.toml", ["run.stop=0.5"]), folder)
    return Run.open(folder)


def test_tables_have_the_numbers_and_units_of_the_run(run: Run, tmp_path: Path) -> None:
    export_run(run, tmp_path / "a.csv", ["master.*"])
    found = np.genfromtxt(tmp_path / "a.csv", delimiter=",", names=True, deletechars="")
    assert found["master.q[3]"].tolist() == run.column("master.q[3]").tolist()
    assert len(found.dtype.names or ()) == 1 + 14  # t, q and tau_h of seven joints
    export_run(run, tmp_path / "a.parquet", ["slave.q", "master_control.tau[2]"])
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.column_names == ["t", "master_control.tau[2]", *run.entries("slave.q")]
    assert table.schema.field("master_control.tau[2]").metadata[b"unit"] == b"N.m"
    assert table["slave.q[6]"].to_numpy().tolist() == run.column("slave.q[6]").tolist()


def test_matlab_gets_a_struct_for_each_component(run: Run, tmp_path: Path) -> None:
    found = loadmat(export_run(run, tmp_path / "a.mat"), simplify_cells=True)
    assert found["t"].tolist() == run.t.tolist()
    assert np.array_equal(found["master"]["q"], run.array("master.q"))
    assert found["units"]["master"] == {"q": "rad", "tau_h": "N.m"}


def test_a_matlab_file_is_that_of_scipy(run: Run, tmp_path: Path) -> None:
    """All bytes behind the text of the head."""
    export_run(run, tmp_path / "a.mat")
    export_run(run, tmp_path / "b.mat", ["master.q[0]"])
    for name in ("a.mat", "b.mat"):
        found = loadmat(tmp_path / name)
        variables = {key: value for key, value in found.items() if not key.startswith("__")}
        savemat(tmp_path / "scipy.mat", variables, long_field_names=True)
        expected = (tmp_path / "scipy.mat").read_bytes()
        assert (tmp_path / name).read_bytes()[124:] == expected[124:]


def test_what_a_matlab_file_cannot_hold_is_said_before_it_is_written(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matlab, "LARGEST", 16 * len(run))
    export_run(run, tmp_path / "a.mat", ["master.q[0]"])
    with pytest.raises(ScenarioError, match=r"master has .* GB, .*expected fewer signals"):
        export_run(run, tmp_path / "b.mat", ["master.q"])
    assert not (tmp_path / "b.mat").exists()
    long = "j" * 64
    with pytest.raises(ScenarioError, match=f"found the name '{long}' of 64 characters"):
        matlab.struct({long: matlab.text("")})


@pytest.mark.parametrize("suffix", [".mat", ".mcap", ".csv", ".parquet"])
def test_files_do_not_depend_on_pieces(
    run: Run, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cosim.record import run as reading

    expected = export_run(run, tmp_path / f"a{suffix}").read_bytes()
    in_groups = tmp_path / "trajectories.parquet"
    pq.write_table(pq.read_table(run.path), in_groups, row_group_size=100)
    (tmp_path / "run.json").write_bytes((run.path.parent / "run.json").read_bytes())
    monkeypatch.setattr(reading, "PIECE", 1)
    monkeypatch.setattr(exported, "ROWS", 64)
    found = export_run(Run.open(tmp_path), tmp_path / f"b{suffix}")
    if suffix == ".parquet":  # whose row groups are those of the run
        assert pq.read_table(found).equals(pq.read_table(tmp_path / f"a{suffix}"))
    else:
        assert found.read_bytes() == expected


def test_numbers_that_json_lacks_are_null_in_mcap(tmp_path: Path) -> None:
    columns = [Column("a.x%y", "rad", 0), Column("b[0]", "m", 1), Column("b[1]", "m", 2)]
    rows = np.array([[1.5, np.nan, -0.0], [np.inf, 1e300, 2.0]])
    writer = GroupWriter(tmp_path / "trajectories.parquet", columns, h=0.5)
    writer.add(rows, 0, last=True)
    writer.close()
    found = messages(export_run(Run.open(tmp_path), tmp_path / "a.mcap"))
    assert [json.loads(text) for _, text in found["/a"]] == [{"x%y": 1.5}, {"x%y": None}]
    assert [text for _, text in found["/b"]] == [b'{"b": [null, -0.0]}', b'{"b": [1e+300, 2.0]}']


def messages(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    found: dict[str, list[tuple[int, bytes]]] = {}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data))
    return found


def test_mcap_has_signals_joint_states_frames_and_the_robot(run: Run, tmp_path: Path) -> None:
    path = export_run(run, tmp_path / "a.mcap")
    found = messages(path)
    assert found.keys() == {
        "/master", "/slave", "/master_control", "/slave_control", "/tf", "/master/joint_states",
        "/slave/joint_states", "/master/scene", "/slave/scene",
    }  # fmt: skip
    at, last = found["/master"][-1]
    assert at == 500_000_000 and len(found["/master"]) == len(run)
    assert json.loads(last)["q"] == run.array("master.q")[-1].tolist()
    robot = serial(URDF, "body", "hand")
    state = found["/master/joint_states"][-1][1]
    assert all(name.encode() in state for name in robot.names)
    assert len(found["/tf"]) == 2 * len(found["/master/joint_states"])
    with path.open("rb") as file:
        attached = {a.name: a.data for a in make_reader(file).iter_attachments()}
    assert attached["openarm_right.urdf"] == URDF.read_bytes()
    assert json.loads(attached["run.json"]) == run.metadata


def test_frames_lead_to_the_end_of_the_arm_as_its_kinematics_say(run: Run) -> None:
    """The origin of the last joint in the frame of the body: published numbers of OpenArm."""
    drawing = next(drawn_arms(run)).drawing
    q = np.array([0.3, 0.5, -0.4, 0.9, 0.2, -0.3, 0.4])
    R, r = np.eye(3), np.zeros(3)
    for turn, step in link_frames(drawing, q):
        R, r = R @ turn, r + R @ step
    assert r == pytest.approx([0.25009393, -0.2655209, 0.4168623], abs=1e-8)
    x, y, z, w = quaternion(R)
    v = np.array([0.2, -0.5, 0.7])
    u = np.array([x, y, z])
    turned = v + 2 * np.cross(u, np.cross(u, v) + w * v)
    assert turned == pytest.approx(R @ v, abs=1e-12) and w >= 0


@pytest.mark.parametrize(
    ("name", "patterns", "said"),
    [
        ("a.xlsx", (), "found 'a.xlsx', expected a file ending in .csv, .parquet, .mat, .mcap"),
        ("a.csv", ("maste.q",), "no signal 'maste.q' was recorded; did you mean 'master.q'"),
    ],
)
def test_mistakes_are_said(
    run: Run, tmp_path: Path, name: str, patterns: tuple[str, ...], said: str
) -> None:
    with pytest.raises(ScenarioError, match=said):
        export_run(run, tmp_path / name, patterns)
    assert not (tmp_path / name).exists()


def test_the_command_writes_what_is_asked_for(cosim: Command, run: Run) -> None:
    folder: Any = run.path.parent
    done = cosim("export", folder, "--to", "a.csv", "--signal", "master.q")
    assert done.code == 0 and f"{len(run)} rows" in done.out
    refused = cosim("export", folder, "--signal", "master.q")
    assert refused.code == 2 and "expected --to FILE" in refused.err


def test_a_gif_has_the_arms_where_they_are(run: Run, tmp_path: Path) -> None:
    """Two planar arms of 1 m links: the tip of the master in the first and the last picture."""
    from PIL import Image

    planar = simulated(teleoperation(stop=2.0), tmp_path / "run")
    path = export_run(planar, tmp_path / "a.gif")
    with Image.open(path) as found:
        count = getattr(found, "n_frames", 1)
        assert count == round(2.0 * RATE) + 1 and found.width == SIZE < found.height
        q = planar.array("master.q")
        for frame, row in ((0, 0), (count - 1, len(q) - 1)):
            found.seek(frame)
            picture = np.asarray(found.convert("RGB")).astype(int)
            a, b = q[row, 0], q[row].sum()
            tip = np.array([[np.cos(a) + np.cos(b), np.sin(a) + np.sin(b)]])
            reach = max(np.abs(tracks(planar)).max(), 1e-6)
            x, y = np.rint(pixels(tip, 0.45 * SIZE / reach))[0].astype(int)
            near = picture[y - 3 : y + 4, x - 3 : x + 4] - (0x00, 0x72, 0xB2)
            assert (np.abs(near).max(axis=-1) < 60).any(), frame
    assert export_run(run, tmp_path / "b.gif").stat().st_size > 2000  # seven joints, in space


def tracks(run: Run) -> np.ndarray:
    """All points of the planar arms at the times of the pictures."""
    rows = np.unique(np.searchsorted(run.t, np.arange(0.0, run.t[-1] + 1e-9, 1 / RATE)))
    arms = list(drawn_arms(run))
    return np.stack(
        [points(a.drawing, run.array(f"{a.name}.q")[k])[:, :2] for a in arms for k in rows]
    )


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_disk_that_is_full_leaves_the_old_file_and_a_sentence(
    run: Run, tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text("old")

    def full() -> int:
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
        with pytest.raises(RunError, match=rf"^cannot write {path}: ") as refused:
            export_run(run, path)
        (tmp_path / "said").write_text(str(refused.value))
        return 0

    _, status = os.waitpid(fork(full), 0)
    assert os.waitstatus_to_exitcode(status) == 0
    assert "part" not in (tmp_path / "said").read_text()
    assert {x.name for x in tmp_path.iterdir()} == {path.name, "said"}
    assert path.read_text() == "old"
