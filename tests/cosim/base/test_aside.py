"""Files that take their name when they are whole."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cosim.base.errors import RunError
from cosim.base.files import write_file, written_aside


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space"), RunError("no")])
def test_what_goes_wrong_leaves_the_old_file_and_nothing_else(tmp_path: Path, error) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")
    raised = KeyboardInterrupt if error is KeyboardInterrupt else RunError
    with pytest.raises(raised), written_aside(path) as part:
        assert part.suffix == ".csv" and part.parent == tmp_path
        part.write_text("half")
        raise error
    assert [x.name for x in tmp_path.iterdir()] == ["a.csv"]
    assert path.read_text() == "old"


def test_messages_name_the_file_and_not_its_place(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    said = r"^cannot write .*/a\.csv: full$"
    with pytest.raises(RunError, match=said), written_aside(path) as part:
        raise RunError(f"cannot write {part}: full")


def test_a_link_stays_one_and_a_pipe_is_written_to(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    write_file(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "file").read_text() == "text"
    os.mkfifo(tmp_path / "pipe")
    reading = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_file(tmp_path / "pipe", b"data")
    assert os.read(reading, 100) == b"data"
    os.close(reading)
    write_file(Path("/dev/null"), "text")
    assert Path("/dev/null").is_char_device()
