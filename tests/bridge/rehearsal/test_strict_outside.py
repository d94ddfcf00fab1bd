"""Strict drives that others wrote (tests/strict_drives/outside) judge what the nodes do to them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.strict_drives.cases import NAMESPACE, ROOT

OUTSIDE = ROOT / "tests" / "strict_drives" / "outside"
PATIENCE = 240.0  # s
pytestmark = [pytest.mark.slow, pytest.mark.timeout(2 * PATIENCE)]


def said(folder: Path, *words: str, **environment: str) -> str:
    """What one of their runs printed."""
    for file in OUTSIDE.iterdir():
        text = file.read_text("utf-8").replace("@PROJECT@", str(ROOT))
        (folder / file.name).write_text(text.replace("@HERE@", str(folder)), "utf-8")
    (folder / "u").mkdir()
    bin_ = folder / "bin"
    bin_.mkdir()
    cosim = bin_ / "cosim"
    cosim.write_text(f"#!{sys.executable}\nfrom cosim.cli import main\nmain()\n", "utf-8")
    cosim.chmod(0o755)
    path = f"{bin_}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [*NAMESPACE, sys.executable, *words], cwd=folder, text=True, capture_output=True,
        timeout=PATIENCE, env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip
    assert shutil.which("cosim", path=path) and done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def numbers(pattern: str, text: str) -> list[float]:
    found = [float(x) for x in re.findall(pattern, text)]
    assert found, text
    return found


DAMIAO = {
    "can-damiao": ("teleoperation", "[1,2]", 4),
    "openarm": ("openarm", "[1,2,3,4,5,6,7]", 4),  # it prints two drives of each arm
}


@pytest.mark.parametrize("deploy", DAMIAO)
def test_damiao(tmp_path: Path, deploy: str) -> None:
    scenario, drives, printed = DAMIAO[deploy]
    path = str(ROOT / "configs" / f"{scenario}.toml")
    text = said(tmp_path, "dm_run.py", "hw", deploy, path, drives, "none", CH="[2,3]")
    assert "LOST_COMM" not in text, text
    assert max(numbers(r"max gap ([\d.]+) ms", text)) <= 25.0, text
    assert numbers(r"while drive not enabled: (\d+)", text) == [0] * printed, text
    assert min(numbers(r"taus nonzero (\d+)", text)) > 0, text
    # The reports of these drives do not move: the run must not pass, and says which do not.
    assert re.search(r"rc [13]$", text, re.MULTILINE), text


def test_damiao_that_reports_an_error(tmp_path: Path) -> None:
    path = str(ROOT / "configs" / "teleoperation.toml")
    text = said(tmp_path, "dm_run.py", "hw", "can-damiao", path, "[1,2]", "D", CH="[2,3]")
    assert re.search(r"rc 1$", text, re.MULTILINE), text
    assert re.search(r"verdict +failed: .*drive 1.*(LOST|communication)", text, re.I), text
    # One torque may be under way when the drive tells; master's drives were forced, both of them.
    assert max(numbers(r"after forced: (\d+)", text)) <= 1, text


def test_odrive(tmp_path: Path) -> None:
    text = said(tmp_path, "od_run.py")
    assert "WATCHDOG_TIMER_EXPIRED" not in text, text
    assert set(numbers(r"of these to an IDLE axis (\d+)", text)) == {0}, text
    assert min(numbers(r"torque frames nonzero (\d+)", text)) > 0, text


def test_cia402(tmp_path: Path) -> None:
    text = said(tmp_path, "cia_run.py")
    assert "heartbeat gap" not in text, text
    assert "SO->OE" in text, text
    assert set(numbers(r"not in OPERATION ENABLED (\d+)", text)) == {0}, text
