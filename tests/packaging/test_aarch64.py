"""The wheel for ARM64 on an emulated processor, with Debian's Python and no compiler: same bits."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cosim.record import Run
from tests.cli.command import CALL, CONFIG
from tests.packaging.test_wheels import SCRIPT

EMULATOR = "qemu-aarch64-static"
#: Debian's packages with an interpreter and the libraries that wheels expect of a system.
PACKAGES = ("python3.11-minimal", "libpython3.11-stdlib", "libstdc++6")
#: The newest C library that wheels may ask for, and older ones.
TAGS = [f"manylinux_2_{n}_aarch64" for n in (17, 26, 27, 28, 31, 34)]


def system(folder: Path) -> Path:
    """A folder with Debian's Python 3.11 for ARM64, unpacked; nothing is installed."""
    for name in ("state/lists/partial", "cache/archives/partial", "root"):
        (folder / name).mkdir(parents=True)
    (folder / "status").touch()
    settings = {
        "APT::Architecture": "arm64",
        "APT::Architectures": "arm64",
        "Dir::State": folder / "state",
        "Dir::State::status": folder / "status",
        "Dir::Cache": folder / "cache",
    }
    apt = ["apt-get", "-qq", *(f"-o{name}={value}" for name, value in settings.items())]
    subprocess.run([*apt, "update"], check=True)
    install = [*apt, "-y", "--download-only", "--no-install-recommends", "install", *PACKAGES]
    subprocess.run(install, check=True)
    for archive in (folder / "cache" / "archives").glob("*.deb"):
        subprocess.run(["dpkg", "-x", archive, folder / "root"], check=True)
    return folder / "root"


def packages(wheel: Path, folder: Path) -> Path:
    """A folder with the package of a wheel and everything that it requires, for ARM64."""
    tags = [word for tag in TAGS for word in ("--platform", tag)]
    pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(folder), *tags]
    pip += ["--only-binary=:all:", "--python-version", "3.11", "--implementation", "cp"]
    subprocess.run([*pip, str(wheel)], check=True)
    return folder


def digest(folder: Path) -> str:
    """The digest of all that a run recorded."""
    run, found = Run.open(folder), hashlib.sha256()
    for name in run.names:
        found.update(name.encode() + np.ascontiguousarray(run.column(name)).tobytes())
    return found.hexdigest()


@pytest.mark.slow
@pytest.mark.timeout(1500)
@pytest.mark.skipif(
    not shutil.which(EMULATOR) or not shutil.which("apt-get"),
    reason="needs Debian's apt-get and qemu-user-static",
)
def test_a_run_on_arm_has_the_bits_of_this_processor(tmp_path: Path) -> None:
    subprocess.run([sys.executable, SCRIPT, tmp_path, "aarch64-linux"], check=True)
    (wheel,) = tmp_path.glob("*aarch64.whl")
    root, site = system(tmp_path / "system"), packages(wheel, tmp_path / "site")
    python = [str(shutil.which(EMULATOR)), str(root / "usr/bin/python3.11")]
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("PYTHON")},
        "PATH": "",
        "PYTHONPATH": str(site),
        "QEMU_LD_PREFIX": str(root),
    }
    machine = [*python, "-c", "import platform; print(platform.machine())"]
    assert subprocess.check_output(machine, env=environment, text=True) == "aarch64\n"
    words = ["run", str(CONFIG), "--quiet", "--out"]
    for call, env in (([*python, *CALL[1:]], environment), (CALL, None)):
        done = subprocess.run(
            [*call, *words, "here" if env is None else "there"],
            cwd=tmp_path, env=env, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert digest(tmp_path / "there") == digest(tmp_path / "here")
    assert (tmp_path / "there" / "report.html").is_file()
