"""Strict drives that others wrote (tests/strict_drives/outside) judge what the nodes do to them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.strict_drives.cases import NAMESPACE, ROOT
from tests.strict_drives.fed import longest_gap, sent_times

OUTSIDE = ROOT / "tests" / "strict_drives" / "outside"
PATIENCE, AGAIN = 240.0, 3  # s; runs on a busy machine
STILL = 5000.0  # us
ODRIVE_TORQUE = 1 << 5 | 0x0E  # CANSimple: Set_Input_Torque of axis 1
pytestmark = [pytest.mark.slow, pytest.mark.timeout(AGAIN * PATIENCE)]


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


def busy(text: str) -> bool:
    """True if this machine had more to do than it can, or let a node wait."""
    late = [float(x) for x in re.findall(r"max (\d+) us in \d+ slots", text)]
    overloaded = os.getloadavg()[0] > 1.5 * (os.cpu_count() or 1)
    return overloaded or max(late, default=0.0) > STILL or "inconclusive" in text


def odrives_were_fed(run: Path) -> bool:
    """True if each node handed a torque for axis 1 to its bus in three quarters of 20 ms."""
    logs = (run / "nodes").glob("*_control.*.frames")
    longest = max((longest_gap(sent_times(log, ODRIVE_TORQUE)) for log in logs), default=0.0)
    return 0.0 < longest < 15e6


def judged(
    folder: Path,
    rules: Callable[[str], Iterator[bool]],
    *words: str,
    fed: Callable[[Path], bool] = lambda _: False,
    **environment: str,
) -> str:
    """The output of a run that keeps the rules; repeated if the machine was too busy to tell.

    These judges stamp frames when Python gets them, so a busy machine lengthens their gaps.
    `fed`: tells by the logs of the nodes that it was the judge who heard them late.
    """
    text, late = "", False
    for k in range(AGAIN):
        (folder / str(k)).mkdir()
        text = said(folder / str(k), *words, **environment)
        if all(rules(text)):
            return text
        late = busy(text) or fed(folder / str(k) / "u" / "od")
        if not late:
            break
    assert late, text  # it starved drives, or the judge
    return text


DAMIAO = {
    "can-damiao": ("teleoperation", "[1,2]", 4),
    "openarm": ("openarm", "[1,2,3,4,5,6,7]", 4),  # it prints two drives of each arm
}


@pytest.mark.parametrize("deploy", DAMIAO)
def test_damiao(tmp_path: Path, deploy: str) -> None:
    scenario, drives, printed = DAMIAO[deploy]
    path = str(ROOT / "configs" / f"{scenario}.toml")

    def rules(text: str) -> Iterator[bool]:
        yield "LOST_COMM" not in text
        yield max(numbers(r"max gap ([\d.]+) ms", text)) <= 25.0
        yield numbers(r"while drive not enabled: (\d+)", text) == [0] * printed
        yield min(numbers(r"taus nonzero (\d+)", text)) > 0

    text = judged(tmp_path, rules, "dm_run.py", "hw", deploy, path, drives, "none", CH="[2,3]")
    # The reports of these drives do not move: the run must not pass, and says which do not.
    assert re.search(r"rc [13]$", text, re.MULTILINE), text


def test_damiao_that_reports_an_error(tmp_path: Path) -> None:
    path = str(ROOT / "configs" / "teleoperation.toml")

    def rules(text: str) -> Iterator[bool]:
        yield bool(re.search(r"drive 1.*(LOST|communication)", text, re.IGNORECASE))
        # One torque may be under way when the drive tells; both drives of master were forced.
        yield max(numbers(r"after forced: (\d+)", text)) <= 1

    text = judged(tmp_path, rules, "dm_run.py", "hw", "can-damiao", path, "[1,2]", "D", CH="[2,3]")
    assert re.search(r"rc [13]$", text, re.MULTILINE), text


def test_odrive(tmp_path: Path) -> None:
    def rules(text: str) -> Iterator[bool]:
        yield "WATCHDOG_TIMER_EXPIRED" not in text
        yield set(numbers(r"of these to an IDLE axis (\d+)", text)) == {0}
        yield min(numbers(r"torque frames nonzero (\d+)", text)) > 0

    judged(tmp_path, rules, "od_run.py", fed=odrives_were_fed)


def test_cia402(tmp_path: Path) -> None:
    def rules(text: str) -> Iterator[bool]:
        yield "heartbeat gap" not in text
        yield "SO->OE" in text
        yield set(numbers(r"not in OPERATION ENABLED (\d+)", text)) == {0}

    judged(tmp_path, rules, "cia_run.py")
