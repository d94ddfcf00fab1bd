"""SHA-256 sums of run folders: every altered file is found and named."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from cosim.base.errors import ScenarioError, Unverified
from cosim.record import seal, verify
from tests.cli.command import CONFIG, Command


def filled(folder: Path) -> Path:
    """A folder with files in it and below it, one with a strange name, one empty."""
    (folder / "links").mkdir(parents=True)
    (folder / "run.json").write_text("{}")
    (folder / "links" / "a -> b, ü.parquet").write_bytes(bytes(range(256)))
    (folder / "empty.err").write_bytes(b"")
    return folder


def test_sums_are_those_of_sha256sum(tmp_path: Path) -> None:
    seal(filled(tmp_path))
    done = subprocess.run(
        ["sha256sum", "-c", "SHA256SUMS"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.count(": OK") == 3
    verify(tmp_path)


def test_a_missing_file_is_named_and_an_added_one_is_not(tmp_path: Path) -> None:
    seal(filled(tmp_path))
    (tmp_path / "notes.txt").write_text("mine")
    verify(tmp_path)
    (tmp_path / "empty.err").unlink()
    with pytest.raises(ScenarioError, match=r"empty\.err: cannot be read: No such file"):
        verify(tmp_path)


def test_sealing_again_adds_files_and_keeps_what_was_known(tmp_path: Path) -> None:
    """A file that was altered in between stays found."""
    seal(filled(tmp_path))
    (tmp_path / "figure.png").write_text("x")
    (tmp_path / "run.json").write_text("{ }")
    seal(tmp_path)
    assert "figure.png" in (tmp_path / "SHA256SUMS").read_text()
    with pytest.raises(ScenarioError, match=r"run\.json: was altered"):
        verify(tmp_path)
    seal(tmp_path, anew=True)
    verify(tmp_path)


def test_a_folder_without_sums_says_so(tmp_path: Path) -> None:
    with pytest.warns(Unverified, match="no SHA256SUMS"):
        verify(filled(tmp_path))


def flip(path: Path, bit: int) -> bytes:
    """Flip one bit of a file; what it was before."""
    before = path.read_bytes()
    data = bytearray(before)
    data[bit // 8 % len(data)] ^= 1 << bit % 8
    path.write_bytes(bytes(data))
    return before


@pytest.mark.parametrize("place", range(0, 8 * 90, 7))
def test_a_flipped_bit_of_the_sums_themselves_is_found(tmp_path: Path, place: int) -> None:
    seal(filled(tmp_path))
    flip(tmp_path / "SHA256SUMS", place)
    with pytest.raises(ScenarioError):
        verify(tmp_path)


def test_one_flipped_bit_in_any_file_of_a_run_is_found(cosim: Command, tmp_path: Path) -> None:
    cosim("run", CONFIG, "--set", "run.stop=1", "--out", "here", "--csv")
    here = tmp_path / "here"
    random = np.random.default_rng(1)
    files = [p for p in sorted(here.rglob("*")) if p.is_file()]
    assert {p.suffix for p in files} == {".parquet", ".json", ".html", ".csv", ""}
    for path in files:
        before = flip(path, int(random.integers(8 * path.stat().st_size)))
        said = cosim.refused("show", "here")
        assert path.name in said, said
        path.write_bytes(before)
    done = cosim("show", "here")
    assert done.code == 0 and "as they were written" in done.out and done.err == ""


def test_diff_names_the_altered_file_and_goes_on_only_when_told_to(
    cosim: Command, tmp_path: Path
) -> None:
    cosim("run", CONFIG, "--set", "run.stop=1", "--out", "a", "--no-plot")
    cosim("run", CONFIG, "--set", "run.stop=1", "--out", "b", "--no-plot")
    assert cosim("diff", "a", "b").code == 0
    path = tmp_path / "b" / "run.json"
    path.write_text(path.read_text().replace('"seed": 0', '"seed": 1'))
    assert "b/run.json: was altered after the run" in cosim.refused("diff", "a", "b")
    assert cosim("diff", "a", "b", "--no-verify").code == 0


def test_a_run_that_was_stopped_has_sums_too(cosim: Command, tmp_path: Path) -> None:
    setting = "components.master_control.parameters.K=400"
    cosim.refused("run", CONFIG, "--set", setting, "--out", "here", code=1)
    verify(tmp_path / "here")
    assert "last.parquet" in (tmp_path / "here" / "SHA256SUMS").read_text()
    assert "stopped" in cosim("show", "here").out
