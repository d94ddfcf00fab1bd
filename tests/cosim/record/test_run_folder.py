"""Run folder: never lost by accident; run.json always whole."""

from __future__ import annotations

import errno
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.base.files import write_file
from cosim.record import (
    Recorder,
    claim_folder,
    held_folder,
    link_file,
    read_metadata,
    write_metadata,
)
from cosim.record.folder import link_files


def test_a_new_folder_is_made_and_an_empty_one_taken(tmp_path: Path) -> None:
    folder = claim_folder(tmp_path / "runs" / "a")
    assert folder.is_dir()
    assert claim_folder(folder) == folder


def test_what_is_there_is_kept_without_force(tmp_path: Path) -> None:
    for name in ("trajectories.parquet", "run.json", "a.png", "b.png"):
        (tmp_path / name).write_text("x")
    with pytest.raises(
        ScenarioError, match=r"not empty \(it contains a\.png, b\.png, run\.json and 1 more"
    ):
        claim_folder(tmp_path)
    assert len(list(tmp_path.iterdir())) == 4


def test_force_deletes_the_files_of_a_run_and_nothing_else(tmp_path: Path) -> None:
    with Recorder(tmp_path, [], h=1.0, n_signals=0):
        pass
    write_metadata(tmp_path, {"scenario": {"components": {"a": {}}, "figures": {"q": {}}}})
    link_file(tmp_path, "old").write_text("x")
    made = ("report.html", "trajectories.csv", "a.fmu.log", "q.png", "q.pdf")
    killed = (".run-7.part.json", ".SHA256SUMS-8.part", ".a.fmu-9.part.log", ".q-10.part.png")
    mine = ["b.fmu.log", "notes.txt", "photo.png", ".notes-7.part.txt", ".run.part.json"]
    for name in (*made, *killed, *mine):
        (tmp_path / name).write_text("x")
    claim_folder(tmp_path, force=True)
    assert sorted(p.name for p in tmp_path.rglob("*")) == sorted([*mine, "links"])
    with Recorder(tmp_path, [], h=1.0, n_signals=0):
        pass


def test_a_run_that_is_partly_deleted_is_not_finished_and_is_deleted_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its deletion ends (as by a kill) before the first file, before the second one and so on."""

    class Killed(BaseException):
        """A stand-in for a signal that ends the process."""

    unlink, left = Path.unlink, 0

    def unlink_some(path: Path, missing_ok: bool = False) -> None:
        nonlocal left
        left -= path.name in names
        if left < 0:
            raise Killed
        unlink(path, missing_ok=missing_ok)

    names = ("run.json", "trajectories.parquet", "report.html", "trajectories.csv", "q.png")
    for before in range(len(names)):
        for name in names:
            (tmp_path / name).write_text("x")
        write_metadata(tmp_path, {"status": "finished", "scenario": {"figures": {"q": {}}}})
        left = before
        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(Path, "unlink", unlink_some)
            claim_folder(tmp_path, force=True)
        assert len(list(tmp_path.iterdir())) == len(names) - before
        assert read_metadata(tmp_path)["status"] == "running"
        claim_folder(tmp_path, force=True)
        assert not list(tmp_path.iterdir())


def test_force_does_not_touch_a_folder_that_is_no_run(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(ScenarioError, match=r"contains thesis\.tex but no earlier run"):
        claim_folder(tmp_path, force=True)
    assert (tmp_path / "thesis.tex").read_text() == "x"


def test_a_folder_is_of_one_run_until_this_ends(tmp_path: Path) -> None:
    with held_folder(tmp_path / "a"), pytest.raises(ScenarioError, match="another command records"):
        held_folder(tmp_path / "a").__enter__()
    with held_folder(tmp_path / "a"):
        assert not list((tmp_path / "a").iterdir())


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ScenarioError, match="cannot use this folder") as caught:
        claim_folder(tmp_path / "file" / "run")
    assert caught.value.place.endswith("run")


def test_metadata_is_sorted_plain_and_comes_back(tmp_path: Path) -> None:
    write_metadata(tmp_path, {"old": 1})
    write_metadata(
        tmp_path,
        {
            "z": np.float64(0.1),
            "a": {"n": np.int64(3), "x": np.array([[1.0, np.nan]]), "path": Path("a")},
            "ξ": (True, None, float("inf")),
        },
    )
    text = (tmp_path / "run.json").read_text(encoding="utf-8")
    assert [key for key in json.loads(text)] == ["a", "z", "ξ"]
    assert read_metadata(tmp_path) == {
        "z": 0.1,
        "a": {"n": 3, "x": [[1.0, None]], "path": "a"},
        "ξ": [True, None, None],
    }
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


def test_keys_of_metadata_that_are_numbers_become_texts(tmp_path: Path) -> None:
    write_metadata(tmp_path, {"b": {2: np.int64(3), 10: float("nan")}, "a": {}})
    assert read_metadata(tmp_path) == {"a": {}, "b": {"2": 3, "10": None}}


def test_metadata_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"run\.json\.links\[1\]: a complex cannot"):
        write_metadata(tmp_path, {"links": [1, 2j]})
    for wrong, name in (({1}, "set"), (b"x", "bytes")):
        with pytest.raises(RunError, match=rf"run\.json\.a: a {name} cannot"):
            write_metadata(tmp_path, {"a": wrong})
    with pytest.raises(RunError, match=r"cannot write .*gone.*run\.json: No such file"):
        write_metadata(tmp_path / "gone", {})
    assert not list(tmp_path.iterdir())


def test_metadata_that_is_damaged_or_missing(tmp_path: Path) -> None:
    assert read_metadata(tmp_path) == {}
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ScenarioError, match=r"run\.json: cannot be read"):
        read_metadata(tmp_path)
    (tmp_path / "run.json").write_text("[]")
    with pytest.raises(ScenarioError, match="found a list, expected an object"):
        read_metadata(tmp_path)


@given(st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=20))
def test_a_link_may_be_called_anything(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    folder = tmp_path_factory.mktemp("run")
    path = link_file(folder, name)
    assert path.parent == folder / "links"
    path.write_text("x")
    assert link_files(folder) == {name: path}


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_file(path, b"old")

    def fills_up() -> Iterator[bytes]:
        yield b"ne"
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(RunError, match=r"cannot write .*a\.json: No space left on device"):
        write_file(path, fills_up())
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]
    assert path.read_bytes() == b"old"
    write_file(path, iter([b"ne", b"w"]))
    assert path.read_bytes() == b"new"
