"""docs/your-own-arm.md: from a URDF file to the file for hardware, by the page's own commands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.deployment.system import load_system
from bridge.preflight import deployment
from tests.cli.command import ROOT
from tests.system.your_own_arm import blocks, commands, prepared

OUTPUTS = [b.text for b in blocks() if b.kind == "text"]


def shell(lines: list[str], folder: Path) -> str:
    """What these commands print, one after the other; each must succeed."""
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(
        ["sh", "-ec", "\n".join(lines)], cwd=folder, capture_output=True, text=True, timeout=300,
        env=os.environ | {"PATH": path},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_its_deployments_differ_in_two_channels_and_pass_without_a_warning(tmp_path: Path) -> None:
    arm = prepared(tmp_path)
    names = ("arm", "hardware")
    texts = [(arm / f"deploy/{name}.toml").read_text().splitlines() for name in names]
    changed = [pair for pair in zip(*texts, strict=True) if pair[0] != pair[1]]
    assert changed == [(f'channel = "vcan{n}"', f'channel = "can{n}"') for n in (0, 1)]
    system = load_system(arm / "arm.toml", "hardware", [])
    assert [f for f in deployment.check(system) if f.severity != "note"] == []
    left = {m.encoding.message.id for m in system.messages.values() if m.bus == "left"}
    assert left == {0x01, 0x02, 0x03, 0x11, 0x12, 0x13}


@pytest.mark.slow
def test_its_commands_give_what_it_shows(tmp_path: Path) -> None:
    """All but those that need a kernel with CAN: tests/vcan has them."""
    start = commands("begin")
    assert start[-1] == "cd my_arm" and start[0].startswith("mkdir")
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    shell(start, tmp_path)
    for path in prepared(tmp_path / "written").rglob("arm.*"):
        target = tmp_path / "my_arm" / path.relative_to(tmp_path / "written/my_arm")
        target.write_bytes(path.read_bytes())
    printed = shell(commands(), tmp_path / "my_arm")
    assert OUTPUTS[0] in printed  # of fmus robot
    assert OUTPUTS[1] in printed  # of cosim check --deploy
    assert printed.count("0 errors, 0 warnings") == 3
    settled = re.findall(r"^settled +after 6\.4\d* s \(together below 0\.02 rad\)$", printed, re.M)
    assert len(settled) == 4  # alone, load known, 4G, twin
    assert re.search(r"^together +0\.6\d* rad", printed, re.M)  # with a load that is not known
    assert "twin                   positions differ by 0 rad RMS" in printed
    assert "no slot missed, replays exactly" in printed
    written = prepared(tmp_path / "again") / "deploy/hardware.toml"
    assert (tmp_path / "my_arm/deploy/hardware.toml").read_text() == written.read_text()
