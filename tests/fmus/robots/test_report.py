"""``fmus robot`` prints the links of a file, or the joints of an arm."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.base.errors import ScenarioError
from fmus import cli
from fmus.robots import report
from tests.fmus.robots import files


def said(*arguments: object) -> list[str]:
    result = CliRunner().invoke(cli.app, ["robot", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output.splitlines()


def test_the_links_of_a_file_are_a_tree(tmp_path: Path) -> None:
    lines = said(files.openarm(tmp_path))
    assert lines[0] == "body"
    assert lines[1] == "  link0, fixed joint mount"
    assert lines[2] == "    link1, revolute joint joint1, 1.142 kg"
    assert lines[-1].strip() == "tcp, fixed joint tool"
    assert len(lines) == 11


def test_the_joints_of_an_arm_have_limits_gravity_and_inertia(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "POSITIONS", 60)
    first, header, *rows = said(files.openarm(tmp_path), "--base", "body", "--tip", "tcp")
    assert first == "7 joints, 4.675 kg beyond the base"
    assert header.split()[2:6] == ["lower", "upper", "effort", "velocity"]
    joint2 = rows[1].split()
    assert joint2[:6] == ["joint2", "revolute", "-0.1745", "3.316", "40", "16.75"]
    assert 8.0 < float(joint2[6]) < 10.2  # torque of gravity, whose greatest is 10.2
    assert 0.059 <= float(joint2[7]) < 0.075  # whose least is 0.059
    held = said(files.openarm(tmp_path), "--base", "body", "--tip", "tcp", "--fixed", "joint3=0.2")
    assert held[0] == "6 joints, 4.675 kg beyond the base"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--base", "body"], "found one of --base and --tip, expected both or none"),
        (["--base", "body", "--tip", "nose"], "no link 'nose' as tip"),
        (["--base", "body", "--tip", "tcp", "--fixed", "joint3"], "'joint3' is not JOINT=NUMBER"),
    ],
)
def test_options_that_cannot_be_are_refused(
    tmp_path: Path, options: list[str], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        said(files.openarm(tmp_path), *options)


def test_an_inertia_that_no_link_of_the_arm_can_have_is_named(tmp_path: Path) -> None:
    """As in a file with g.mm2 for kg.m2."""
    path = files.openarm(tmp_path)
    text = path.read_text(encoding="utf-8")
    first = text.index("<inertia ")
    end = text.index("/>", first)
    heavy = '<inertia ixx="2661" ixy="0" ixz="0" iyy="2661" iyz="0" izz="2661"'
    assert not said(path, "--base", "body", "--tip", "tcp")[-1].startswith("link")
    path.write_text(text[:first] + heavy + text[end:], encoding="utf-8")
    last = said(path, "--base", "body", "--tip", "tcp")[-1]
    assert last.startswith("link 0 has 1.142 kg, 2661 kg.m2 (a radius of gyration of 48.3 m)")
