"""Wheels for all platforms: what is in them is for the platform that their tag names."""

from __future__ import annotations

import io
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from fmus.build.toolchain import PLATFORMS, host_platform

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "build_backend" / "wheels.py"
#: How a library of each platform begins, and its processor: bytes at an offset (ELF, PE, Mach-O).
MACHINES = {
    "x86_64-linux": (b"\x7fELF", 18, b"\x3e\x00"),
    "aarch64-linux": (b"\x7fELF", 18, b"\xb7\x00"),
    "x86_64-windows": (b"MZ", None, b"PE\x00\x00\x64\x86"),
    "aarch64-darwin": (b"\xcf\xfa\xed\xfe", 4, b"\x0c\x00\x00\x01"),
}


def is_for(library: bytes, platform: str) -> bool:
    """True if a shared library is one of a platform."""
    begin, offset, machine = MACHINES[platform]
    if offset is None:  # the place is at 0x3c
        offset = int.from_bytes(library[0x3C:0x40], "little")
    return library.startswith(begin) and library[offset:].startswith(machine)


def test_there_is_a_tag_for_each_platform(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "build_backend"))
    from cosim_build import TAGS

    assert set(TAGS) == set(PLATFORMS)


def test_unknown_platforms_are_refused_with_those_that_there_are(tmp_path: Path) -> None:
    call = [sys.executable, str(SCRIPT), str(tmp_path / "out"), "riscv-linux"]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "platforms: x86_64-linux, aarch64-linux" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("platform", list(MACHINES))
def test_a_wheel_has_libraries_and_fmus_of_its_platform(platform: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(tmp_path), platform],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    wheel = Path(done.stdout.strip())
    libraries = []
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        stems = ("cosim/_engine.", "cosim/_bus.", "bridge/_bridge.")
        libraries += [archive.read(n) for n in names if n.startswith(stems) and "json" not in n]
        for name in (n for n in names if n.endswith(".fmu")):
            with zipfile.ZipFile(io.BytesIO(archive.read(name))) as fmu:
                binaries = [n for n in fmu.namelist() if n.startswith("binaries/")]
                libraries += [fmu.read(n) for n in binaries if not n.endswith("/")]
        assert "cosim/reporting/assets/uPlot.iife.js" in names
    assert len(libraries) > 60 and all(is_for(library, platform) for library in libraries)
    if platform.endswith("linux"):
        tool = [sys.executable, "-m", "auditwheel", "show", str(wheel)]
        said = subprocess.run(tool, capture_output=True, text=True, check=True).stdout
        assert "is consistent" in said and f'"manylinux_2_17_{platform.split("-")[0]}"' in said
    if platform == host_platform():
        run_without_a_compiler(wheel, tmp_path)


def run_without_a_compiler(wheel: Path, folder: Path) -> None:
    """Run a scenario with the package of a wheel, and what this environment has else."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    code = "import sys; from cosim.cli import main; sys.argv[0] = 'cosim'; main()"
    words = ["run", str(ROOT / "configs/teleoperation.toml"), "--stop", "1", "--out", "out"]
    env = {"PATH": "", "HOME": str(folder), "PYTHONPATH": str(folder / "site"), "LANG": "C.UTF-8"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code, *words],
        cwd=folder, env=env, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (folder / "out" / "report.html").is_file()
    where = [sys.executable, "-P", "-c", "import cosim; print(cosim.__file__)"]
    found = subprocess.run(where, cwd=folder, env=env, capture_output=True, text=True, check=True)
    assert found.stdout.startswith(str(folder / "site"))
