"""Parts of a comparison: made in any order, and put together to the files of one call."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.cli.command import Command
from tests.cosim.comparison.parts import CONFIG, SMALL, push, written

TEXT = SMALL + push("pushes") + push("fails", fail_at=0.5)
FILES = ("table.csv", "table.json", "table.md")


@pytest.fixture
def compared(tmp_path: Path) -> tuple[str | Path, ...]:
    """A comparison of three controllers with four seeds."""
    variants = written(tmp_path, TEXT)
    return ("compare", CONFIG, "--variants", variants, "--controllers", "all", "--seeds", "4",
            "--jobs", "1", "--no-plot")  # fmt: skip


def parts(folder: Path) -> list[Path]:
    return sorted((folder / "runs/compare-teleoperation.parts").iterdir())


def test_parts_in_any_order_give_the_files_of_one_call(
    cosim: Command, tmp_path: Path, compared: tuple[str | Path, ...]
) -> None:
    assert cosim(*compared, "--out", "out").code == 0
    whole = {str(p.relative_to("out")): p.read_bytes() for p in Path("out").rglob("*.*")}
    assert "links/constant-seed3/master-slave.parquet" in whole or len(whole) > len(FILES)
    order = list(range(1, 8))
    random.Random(5).shuffle(order)
    for k in order:
        done = cosim(*compared, "--part", f"{k}/7")
        assert done.code == 0, done.err
        assert f"part {k} of 7: {2 if k < 6 else 1} runs" in done.out
    Path("out").rename("whole")
    folders = parts(tmp_path)
    random.Random(6).shuffle(folders)
    done = cosim(*compared, "--merge", *folders, "--out", "out")
    assert done.code == 0, done.err
    assert "12 runs; 12 there already; 0 to run" in done.out
    assert {str(p.relative_to("out")): p.read_bytes() for p in Path("out").rglob("*.*")} == whole


def test_a_part_that_was_killed_is_made_again(
    cosim: Command, tmp_path: Path, compared: tuple[str | Path, ...]
) -> None:
    assert cosim(*compared, "--out", "whole").code == 0
    for k in (1, 2):
        assert cosim(*compared, "--part", f"{k}/2").code == 0
    first, second = parts(tmp_path)
    for folder in (first, second):  # as a process leaves it that is killed
        lines = (folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
        (folder / "journal.jsonl").write_bytes(b"".join(lines[:2]) + lines[2][:40])
        (folder / "SHA256SUMS").unlink()
    said = cosim.refused(*compared, "--merge", first, second, "--out", "early", code=1)
    assert said == "8 runs are missing" and not Path("early").exists()
    again = cosim(*compared, "--part", "1/2")
    assert again.code == 2 and "use --resume to continue it" in again.err
    assert "6 runs; 2 there already; 4 to run" in cosim(*compared, "--part", "1/2", "--resume").out
    assert cosim(*compared, "--part", "2/2", "--out", "elsewhere").code == 0
    done = cosim(*compared, "--merge", first, second, "elsewhere", "--out", "merged")
    assert done.code == 0, done.err
    assert Path("merged/table.csv").read_bytes() == Path("whole/table.csv").read_bytes()


def test_a_folder_without_its_tables_is_named(
    cosim: Command, tmp_path: Path, compared: tuple[str | Path, ...]
) -> None:
    assert cosim(*compared, "--part", "1/1").code == 0
    (folder,) = parts(tmp_path)
    folder = folder.rename(tmp_path / "moved")
    assert cosim(*compared, "--merge", folder, "--out", "merged").code == 0
    for path in (folder / "tables").iterdir():
        path.unlink()
    said = cosim.refused(*compared, "--merge", folder, "--out", "out", code=1)
    assert "moved/tables; expected all files of the folder" in said and ".parquet" in said


def test_missing_parts_and_those_of_another_comparison_are_named(
    cosim: Command, tmp_path: Path, compared: tuple[str | Path, ...]
) -> None:
    for k in (1, 3):
        assert cosim(*compared, "--part", f"{k}/4").code == 0
    first, third = parts(tmp_path)
    said = cosim.refused(*compared, "--merge", first, third, "--out", "out", code=1)
    assert said == "6 runs are missing: parts 2/4, 4/4"
    said = cosim.refused(*compared, "--set", "run.stop=1 s", "--merge", first, "--out", "out")
    assert "found a part whose comparison is" in said and "with which the parts were made" in said
    said = cosim.refused(*compared, "--merge", tmp_path, "--out", "out")
    assert said.endswith("found no part there")
    said = cosim.refused(*compared, "--part", "2/4", "--out", first, "--resume")
    assert "the folder contains part 1 of 4, expected part 2 of 4" in said
    assert "expected --keep with each part" in cosim.refused(*compared, "--keep", "--merge", first)
    assert "found --merge with --part" in cosim.refused(*compared, "--part", "1/4", "--merge", "a")
    assert not Path("out").exists()
