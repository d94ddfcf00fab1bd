"""python-can's own tests of interfaces, from its source distribution, on ``cosim``."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
from pathlib import Path

import can
import pytest

SUITE = """
import can
from .back2back_test import Back2BackTestCase as Base, TestThreadSafeBus as ThreadSafe


class TestCosim(Base):
    INTERFACE_1 = INTERFACE_2 = "cosim"
    CHANNEL_1 = CHANNEL_2 = "back2back"


class TestCosimThreadSafe(ThreadSafe):
    INTERFACE_1 = INTERFACE_2 = "cosim"
    CHANNEL_1 = CHANNEL_2 = "back2back"


del Base, ThreadSafe
"""


def source(folder: Path) -> Path:
    """The folder of python-can's source distribution, of the version that is installed."""
    wanted = f"python-can=={can.__version__}"
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps"]
    try:
        found = subprocess.run(
            [*command, "--no-binary", "python-can", "-d", str(folder), wanted],
            capture_output=True, text=True, timeout=240,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        pytest.skip(f"the source distribution of {wanted} was not there within 240 s")
    archives = list(folder.glob("*.tar.gz"))
    if found.returncode or not archives:
        reason = found.stderr.strip().splitlines() or ["pip brought nothing"]
        pytest.skip(f"no source distribution of {wanted}: {reason[-1]}")
    with tarfile.open(archives[0]) as archive:
        archive.extractall(folder, filter="data")
    return next(path for path in folder.iterdir() if (path / "test").is_dir())


@pytest.mark.slow
def test_the_suite_of_python_can_passes(tmp_path: Path) -> None:
    if "cosim" not in can.VALID_INTERFACES:
        pytest.skip("installed before the entry point was there: pip install -e . again")
    folder = source(tmp_path)
    (folder / "test" / "cosim_test.py").write_text(SUITE, encoding="utf-8")
    ran = subprocess.run(
        [
            sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "addopts=",
            "--timeout=60", "-rs", "test/cosim_test.py",
        ],
        cwd=folder, capture_output=True, text=True, timeout=280,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout[-4000:] + ran.stderr[-2000:]
    passed = re.search(r"(\d+) passed", ran.stdout)
    assert passed, ran.stdout
    assert int(passed[1]) >= 30, ran.stdout
