"""FMUs that cannot run: one sentence each, exit code 2, nothing left behind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.models import planar2r
from tests.cli import broken
from tests.cli.command import Command

SCENARIO = '[run]\nstep = 0.001\nstop = 0.01\n[components.arm]\nmodel = "{}"\n'


def scenario(model: str) -> str:
    Path("arm.toml").write_text(SCENARIO.format(model), encoding="utf-8")
    return "arm.toml"


@pytest.mark.parametrize(
    ("files", "message"), broken.BROKEN, ids=[f.__name__ for f, _ in broken.BROKEN]
)
def test_a_broken_fmu_is_refused(
    cosim: Command, tmp_path: Path, files: Callable[[], broken.Files], message: str
) -> None:
    broken.written(files(), tmp_path / "arm.fmu")
    said = cosim.refused("run", scenario("arm.fmu"), "--out", "here")
    assert message in said
    assert "arm" in said
    assert not (tmp_path / "here").exists()
    assert not (tmp_path.parent / "outside.txt").exists()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing.fmu", None, "missing.fmu: no such file"),
        ("text.fmu", b"not an archive", "not a readable FMU (ZIP archive)"),
        ("empty.fmu", b"", "not a readable FMU (ZIP archive)"),
    ],
)
@pytest.mark.parametrize("command", ["run", "show", "info"])
def test_a_file_that_is_no_fmu_is_refused(
    cosim: Command, command: str, name: str, content: bytes | None, message: str
) -> None:
    if content is not None:
        Path(name).write_bytes(content)
    said = cosim.refused(command, name if command == "info" else scenario(name))
    assert message in said
    assert command == "info" or "arm.toml at components.arm.model: " in said


def test_a_truncated_archive_is_refused(cosim: Command, tmp_path: Path) -> None:
    good = planar2r.fmu().read_bytes()
    (tmp_path / "half.fmu").write_bytes(good[: len(good) // 2])
    assert "not a readable FMU (ZIP archive)" in cosim.refused("info", "half.fmu")


def test_a_damaged_archive_is_refused(cosim: Command, tmp_path: Path) -> None:
    content = bytearray(broken.written(broken.contents(), tmp_path / "x.fmu").read_bytes())
    place = content.index(b"<fmiModelDescription")
    content[place : place + 40] = bytes(40)
    (tmp_path / "damaged.fmu").write_bytes(content)
    assert "not a readable FMU (ZIP archive): Bad CRC-32" in cosim.refused("info", "damaged.fmu")


def test_a_cache_that_cannot_be_written_is_gone_around(
    cosim: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken.written(broken.contents(), tmp_path / "arm.fmu")
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert cosim("run", scenario("arm.fmu")).code == 0
