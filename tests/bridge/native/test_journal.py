"""Rows written to a journal survive SIGKILL; files that are not journals are refused."""

import ctypes
import gc
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from bridge.native import journal as journals
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Frame, Ring, frame_dtype
from bridge.native.journal import HEADER, Journal, JournalError, JournalStruct, row_of
from bridge.recording.journal_tail import JournalTail
from tests.footprint import open_files

ROW = np.dtype([("t_ns", "<i8"), ("state", "u1"), ("q", "<f8", (3,))])


def test_header_is_the_one_of_c():
    assert ctypes.sizeof(JournalStruct) == HEADER


def test_rows_of_bytes_are_kept_to_the_bit_until_it_is_full(tmp_path: Path):
    """Also numbers that are none, whose bits a conversion might change."""
    signalling = np.frombuffer(np.uint64(0x7FF0000000000001).tobytes())[0]
    row = np.array([(7, 1, [signalling, -0.0, np.inf])], ROW).tobytes()
    journal = Journal.create(tmp_path / "j", ROW, 2)
    assert [journal.append_bytes(row) for _ in range(3)] == [True, True, False]
    assert journal.dropped == 1
    assert journal.rows.tobytes() == 2 * row
    with pytest.raises(ValueError, match=f"{len(row) - 1} bytes; expected a row of {len(row)}"):
        journal.append_bytes(row[1:])
    journal.close()
    assert Journal.open(tmp_path / "j").tobytes() == 2 * row


@pytest.mark.parametrize("closed", [False, True])
def test_rows_written_are_read(tmp_path: Path, closed: bool):
    journal = Journal.create(tmp_path / "j", ROW, 10)
    for k in range(4):
        assert journal.append(k, k + 1, [0.5 * k, np.nan, -k])
    if closed:
        journal.close()
    rows = Journal.open(tmp_path / "j")
    assert rows.dtype == ROW
    assert rows["t_ns"].tolist() == [0, 1, 2, 3]
    assert rows["q"][:, 0].tolist() == [0, 0.5, 1, 1.5]
    assert not rows.flags.writeable


def test_full_journal_counts_and_drops(tmp_path: Path):
    journal = Journal.create(tmp_path / "j", ROW, 2)
    assert [journal.append(k, 0, [0, 0, 0]) for k in range(5)] == [True, True, False, False, False]
    assert journal.dropped == 3
    assert Journal.open(tmp_path / "j")["t_ns"].tolist() == [0, 1]


def test_closing_cuts_the_file_to_what_was_written(tmp_path: Path):
    with Journal.create(tmp_path / "j", ROW, 100_000) as journal:
        journal.append(7, 0, [1, 2, 3])
        before = (tmp_path / "j").stat().st_size
    assert before > 3_000_000 > 1_000 > (tmp_path / "j").stat().st_size
    assert Journal.open(tmp_path / "j")["t_ns"].tolist() == [7]


def test_empty_journal_has_no_rows(tmp_path: Path):
    Journal.create(tmp_path / "j", ROW, 1).close()
    assert len(Journal.open(tmp_path / "j")) == 0


def test_reading_while_it_is_written(tmp_path: Path):
    journal = Journal.create(tmp_path / "j", ROW, 5)
    journal.append(1, 0, [0, 0, 0])
    first = Journal.open(tmp_path / "j")
    journal.append(2, 0, [0, 0, 0])
    assert len(first) == 1
    assert len(Journal.open(tmp_path / "j")) == 2


def disk(path: Path) -> int:
    """Bytes that a file takes."""
    return path.stat().st_blocks * 512


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has pieces")
def test_space_is_taken_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A node of four hours took the disk and the memory of all of them before its first slot."""
    monkeypatch.setattr(journals, "AHEAD", 1 << 18)
    n = 1_000_000
    with Journal.create(tmp_path / "j", ROW, n) as journal:
        assert disk(tmp_path / "j") < 1 << 20 < 30_000_000 < (tmp_path / "j").stat().st_size
        for k in range(50_000):
            assert journal.append(k, 0, [k, k, k])
        assert disk(tmp_path / "j") < 50_000 * ROW.itemsize + (1 << 20)
        assert np.array_equal(Journal.open(tmp_path / "j")["t_ns"], np.arange(50_000))
    rows = Journal.open(tmp_path / "j")
    assert np.array_equal(rows["q"], np.arange(50_000.0)[:, None] + np.zeros(3))


def test_a_writer_in_c_makes_room_itself_while_others_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Three threads map the same pages; no row is lost, and none is changed."""
    monkeypatch.setattr(journals, "AHEAD", 1 << 16)
    n, over = 30_000, threading.Event()
    log = Journal.create(tmp_path / "j", frame_dtype(), n)
    bus = Bus.from_rings(Ring(2), Ring(2), log=log, kind=BusKind.MEMORY)

    def grow() -> None:
        while not over.is_set():
            log.make_room()

    growing = [threading.Thread(target=grow) for _ in range(2)]
    for thread in growing:
        thread.start()
    frame, taken = Frame.of(1, bytes(8)), Frame()
    try:
        for k in range(n):
            bus.tx.get(taken)
            frame.t_ns = k
            bus.send(frame)
    finally:
        over.set()
        for thread in growing:
            thread.join()
    assert log.dropped == 0
    assert np.array_equal(Journal.open(tmp_path / "j")["t_ns"], np.arange(n))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has pieces")
def test_room_that_is_there_already_is_not_taken_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(journals, "AHEAD", 1 << 18)
    with Journal.create(tmp_path / "j", ROW, 100_000) as journal:
        room = journal.struct.limit
        assert room > 7_000
        monkeypatch.setattr(journals, "AHEAD", 1)
        journal.make_room()
        assert journal.struct.limit == room
        assert all(journal.append(k, 0, [k, k, k]) for k in range(room))
    assert np.array_equal(Journal.open(tmp_path / "j")["t_ns"], np.arange(room))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has pieces")
def test_rows_without_space_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A disk that is full in a run ends no process, and what was written before is there."""
    monkeypatch.setattr(journals, "AHEAD", 1 << 16)
    with Journal.create(tmp_path / "j", ROW, 100_000) as journal:
        right, room = journal.struct.descriptor, journal.struct.limit
        journal.struct.descriptor = 1 << 20  # a file that does not grow
        written = sum(journal.append(k, 0, [0, 0, 0]) for k in range(room + 5))
        journal.struct.descriptor = right
        assert (written, journal.dropped) == (room, 5)
    assert len(Journal.open(tmp_path / "j")) == room


WRITER = """
import sys, numpy as np
from bridge.native.journal import Journal
from bridge.native.bus import Bus, BusKind
from bridge.native.frame import Frame, Ring, frame_dtype
log = Journal.create(sys.argv[1], frame_dtype(), 1 << 16)
bus = Bus.from_rings(Ring(2), Ring(2), log=log, kind=BusKind.MEMORY)
frame, n = Frame.of(1, bytes(8)), 0
while True:
    bus.tx.get(Frame())
    frame.t_ns = n = n + 1
    bus.send(frame)
    if n == 1000:
        print("going", flush=True)
"""


def test_everything_committed_survives_sigkill(tmp_path: Path):
    """C writes rows as quickly as it can; SIGKILL; all that were committed are there, none torn."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "j")], stdout=subprocess.PIPE, env=environment
    )
    assert writer.stdout is not None and writer.stdout.readline() == b"going\n"
    while len(Journal.open(tmp_path / "j")) < 5000:
        assert writer.poll() is None
    alive = len(Journal.open(tmp_path / "j"))
    writer.kill()
    assert writer.wait() == -signal.SIGKILL
    writer.stdout.close()
    rows = Journal.open(tmp_path / "j")
    assert len(rows) >= alive
    assert np.array_equal(rows["t_ns"], np.arange(1, len(rows) + 1))
    assert np.array_equal(rows["sequence"], np.arange(len(rows)))


def test_no_room_is_an_error_at_once(tmp_path: Path):
    with pytest.raises(JournalError, match=r"cannot create \d+ bytes"):
        Journal.create(tmp_path / "j", ROW, 1 << 50)
    assert not (tmp_path / "j").exists()
    with pytest.raises(JournalError, match="No such file"):
        Journal.create(tmp_path / "nowhere" / "j", ROW, 1)
    with pytest.raises(JournalError, match="expected at least one row"):
        Journal.create(tmp_path / "j", ROW, 0)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda data: b"", "cannot mmap an empty file"),
        (lambda data: b"candump!" + data[8:], "begins with b'candump!'"),
        (lambda data: data[:-10], "the file is damaged"),
        (lambda data: data[:8] + b"\x09" + data[9:], "version 9; expected 1"),
        (lambda data: data[:24] + b"\xff" + data[25:], "the file is damaged"),
        (lambda data: data[:-2] + b"(]", "invalid description"),
    ],
)
def test_what_is_no_journal_is_refused(tmp_path: Path, damage, message: str):
    with Journal.create(tmp_path / "j", ROW, 5) as journal:
        journal.append(1, 0, [0, 0, 0])
    (tmp_path / "k").write_bytes(damage((tmp_path / "j").read_bytes()))
    with pytest.raises(JournalError, match=message):
        Journal.open(tmp_path / "k")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("('<f8',)", "invalid description"),
        ("{}", "rows of 8 bytes, described as 0"),
        ("[" * 150, "invalid description"),
        ("-" * 5000 + "1", "invalid description"),
        ("[('a', '<f8', -1)]", "invalid description"),
        ("'<f8'", "rows of float64; expected fields of numbers"),
        ("[('a', 'O')]", "expected fields of numbers"),
        ("[('a', '<f4')]", "rows of 8 bytes, described as 4"),
    ],
)
def test_what_describes_no_rows_is_refused(text: str, message: str) -> None:
    with pytest.raises(JournalError, match=message):
        row_of(Path("j"), text.encode(), 8)


def test_rows_of_no_bytes_are_refused() -> None:
    with pytest.raises(JournalError, match="rows of 0 bytes"):
        row_of(Path("j"), b"[('a', '|V0')]", 0)


def test_nobody_finds_half_a_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever makes it may be killed at any moment; readers look for the name."""
    seen = []

    def look(aside: Path, path: Path) -> None:
        seen.append(path.exists())
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", look)
    with pytest.raises(KeyboardInterrupt):
        Journal.create(tmp_path / "a.journal", np.dtype([("x", "<f8")]), 4)
    assert seen == [False] and not list(tmp_path.glob("*.journal"))


@pytest.mark.skipif(sys.platform != "linux", reason="counts files in /proc")
def test_what_nobody_closes_keeps_no_file_open(tmp_path: Path):
    """A process that makes many journals, of runs that fail, does not run out of files."""
    gc.collect()
    before = open_files()
    journal = Journal.create(tmp_path / "j", ROW, 10)
    journal.append(1, 2, [0, 0, 0])
    tail, view = JournalTail(tmp_path / "j"), journal.rows
    assert open_files() > before
    with pytest.warns(ResourceWarning, match="unclosed file"):
        del journal, tail
        gc.collect()
    assert open_files() == before
    assert view["t_ns"].tolist() == [1]  # rows that somebody still has are there
    with Journal.create(tmp_path / "j", ROW, 10), JournalTail(tmp_path / "j"):
        pass
    assert open_files() == before
