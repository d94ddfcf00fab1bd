"""Parts of a study: made anywhere, in any order, and put together to the table of one call."""

from __future__ import annotations

import json
import random
import signal
import subprocess
from pathlib import Path
from time import sleep

import pytest

from cosim.base.errors import ScenarioError
from cosim.study.parts import StudyPart
from tests.cli.command import Command
from tests.cosim.study.studies import STUDY, journal, started, written

PARTS = 40
GRID = (
    STUDY
    + "values = [1, 10, 150, 205, 1500]\n"
    + """
[vary.x]
path = "components.plant.start.x"
range = [1, 2]
count = 25
"""
)
SLOW = "settings = [\"components.gain.parameters.wait='100 ms'\"]\n" + STUDY
SLOW += "range = [1, 40]\ncount = 30\n"
QUIET = ("--workers", "threads", "--no-plot", "--quiet")


def test_forty_parts_in_any_order_give_the_table_of_one_call(
    cosim: Command, tmp_path: Path
) -> None:
    study = written(tmp_path, GRID)
    assert cosim("sweep", study, "--out", "whole", *QUIET).code == 0
    order = list(range(1, PARTS + 1))
    random.Random(3).shuffle(order)
    for k in order:
        assert cosim("sweep", study, "--part", f"{k}/{PARTS}", *QUIET).code == 0
    folders = sorted((tmp_path / "runs/study.parts").iterdir())
    assert [f.name for f in folders][:2] == ["01-of-40", "02-of-40"]
    random.Random(4).shuffle(folders)
    done = cosim("sweep", study, "--merge", *folders, "--out", "merged", "--no-plot")
    assert done.code == 0, done.err
    assert "125 runs: 100 stable, 25 not" in done.out
    for name in ("table.parquet", "summary.csv"):
        assert (tmp_path / "merged" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_parts_that_were_killed_are_made_again(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, SLOW)
    assert cosim("sweep", study, "--out", "whole", *QUIET).code == 0
    for k in (1, 2):
        process = started("study.toml", "--part", f"{k}/3", "--no-plot", cwd=tmp_path)
        folder = tmp_path / f"runs/study.parts/{k}-of-3"
        while len(journal(folder)) < 2:
            assert process.poll() is None, process.communicate()
            sleep(0.005)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60)
    assert cosim("sweep", study, "--part", "3/3", *QUIET).code == 0
    folders = [tmp_path / f"runs/study.parts/{k}-of-3" for k in (1, 2, 3)]
    early = cosim("sweep", study, "--merge", *folders, "--out", "early", *QUIET)
    assert early.code == 1 and "runs are missing" in early.err  # what was killed is there, as far
    assert cosim("sweep", study, "--part", "1/3", "--resume", *QUIET).code == 0
    elsewhere = tmp_path / "again"  # on another host the whole part is made anew
    assert cosim("sweep", study, "--part", "2/3", "--out", elsewhere, *QUIET).code == 0
    done = cosim("sweep", study, "--merge", *folders, elsewhere, "--out", "merged", *QUIET)
    assert done.code == 0, done.err
    table = (tmp_path / "merged/table.parquet").read_bytes()
    assert table == (tmp_path / "whole/table.parquet").read_bytes()


def test_parts_run_side_by_side(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, GRID)
    assert cosim("sweep", study, "--out", "whole", *QUIET).code == 0
    calls: list[subprocess.Popen[str]] = [
        started("study.toml", "--part", f"{k}/4", *QUIET, cwd=tmp_path) for k in range(1, 5)
    ]
    assert [call.wait(timeout=120) for call in calls] == [0] * 4
    for call in calls:
        call.communicate()
    folders = [tmp_path / f"runs/study.parts/{k}-of-4" for k in range(1, 5)]
    assert cosim("sweep", study, "--merge", *folders, "--out", "merged", *QUIET).code == 0
    table = (tmp_path / "merged/table.parquet").read_bytes()
    assert table == (tmp_path / "whole/table.parquet").read_bytes()


def test_a_part_that_is_missing_is_named(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, GRID)
    for k in (1, 3):
        assert cosim("sweep", study, "--part", f"{k}/4", *QUIET).code == 0
    folders = sorted((tmp_path / "runs/study.parts").iterdir())
    done = cosim("sweep", study, "--merge", *folders, "--out", "merged", *QUIET)
    assert done.code == 1
    assert "62 runs are missing: parts 2/4, 4/4" in done.err
    rest = [cosim("sweep", study, "--part", f"{k}/4", *QUIET) for k in (2, 4)]
    assert [x.code for x in rest] == [0, 0]
    folders = sorted((tmp_path / "runs/study.parts").iterdir())
    again = cosim("sweep", study, "--merge", *folders, "--out", "merged", "--resume", *QUIET)
    assert again.code == 0, again.err


def test_a_run_that_failed_in_one_folder_only_has_not_failed(
    cosim: Command, tmp_path: Path
) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    study = written(tmp_path, GRID)
    assert cosim("sweep", study, "--out", "whole", *QUIET).code == 0
    for name in ("a", "b"):
        assert cosim("sweep", study, "--out", name, *QUIET).code == 0
    (part,) = (tmp_path / "b/results").iterdir()
    rows = pq.read_table(part)
    lost = ["the worker died"] * len(rows)
    place = rows.column_names.index("reason")
    pq.write_table(rows.set_column(place, "reason", pa.array(lost)), part)
    folders = [tmp_path / "a", tmp_path / "b"]
    assert cosim("sweep", study, "--merge", *folders, "--out", "merged", *QUIET).code == 0
    merged = pq.read_table(tmp_path / "merged/table.parquet")
    whole = pq.read_table(tmp_path / "whole/table.parquet")
    assert merged["stable"].to_pylist() == whole["stable"].to_pylist()
    assert [x for x in merged["reason"].to_pylist() if x == "the worker died"] == [
        "the worker died" for x in whole["reason"].to_pylist() if x
    ]


@pytest.mark.parametrize("text", ["0/4", "5/4", "3", "a/b", "1/0", "-1/4", "1.5/4"])
def test_parts_that_cannot_be_are_refused(text: str) -> None:
    with pytest.raises(ScenarioError, match="expected K/N with 1 <= K <= N, as 3/40"):
        StudyPart.read(text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--part", "1/4", "--merge", "a"), "found --merge with --part"),
        (("--merge",), "found no folder, expected those of the parts"),
        (("a",), "found a without --merge"),
        (("--merge", "nothing"), "nothing: found no part of a study there"),
    ],
)
def test_options_that_do_not_fit_together_are_refused(
    cosim: Command, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    done = cosim("sweep", written(tmp_path, GRID), *arguments)
    assert done.code == 2 and words in done.err


def test_folders_of_other_studies_and_parts_are_refused(cosim: Command, tmp_path: Path) -> None:
    study = written(tmp_path, GRID)
    assert cosim("sweep", study, "--part", "1/4", "--out", "a", *QUIET).code == 0
    other = cosim("sweep", study, "--part", "2/4", "--out", "a", "--resume", *QUIET)
    assert other.code == 2
    assert "the folder contains part 1 of 4, expected part 2 of 4" in other.err
    study.write_text(study.read_text().replace("205", "206"))
    changed = cosim("sweep", study, "--merge", "a", "--out", "merged", *QUIET)
    assert changed.code == 2 and "found rows of another study" in changed.err


def test_points_that_follow_from_results_are_not_divided(cosim: Command, tmp_path: Path) -> None:
    text = STUDY + "uniform = [1, 300]\n[boundary]\nruns = 40\nbatch = 8\n"
    done = cosim("sweep", written(tmp_path, text), "--part", "1/4", *QUIET)
    assert done.code == 2 and "found [boundary], whose points follow" in done.err
    state = tmp_path / "runs/study.parts/1-of-4/sweep.json"
    assert not state.exists() or json.loads(state.read_text())
