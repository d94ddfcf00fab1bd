"""Recorder: the content of the file depends on the rows only, and failures are reported."""

from __future__ import annotations

import errno
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep
from types import SimpleNamespace
from typing import Literal

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import CutShort, RunError, ScenarioError
from cosim.record import Column, Recorder, Run, groups

H = 1e-3
SIGNALS = 4
COLUMNS = (Column("a.q[0]", "rad", 2), Column("a.q[1]", "rad", 0), Column("b.tau", "N.m", 3))


@pytest.fixture(autouse=True, scope="module")
def small_groups() -> Iterator[None]:
    """Row groups of 8 rows, so that a few rows cross many boundaries."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "_GROUP_LEAST", 8)
        patch.setattr(groups, "_GROUP_MOST", 8)
        yield


def signals(n: int, width: int = SIGNALS) -> np.ndarray:
    """n rows that are all different: entry j of row k is k + j/8."""
    return np.arange(n)[:, None] + np.arange(width) / 8


def record(
    folder: Path, rows: np.ndarray, chunks: list[int], *, every: int = 1, k0: int = 0
) -> bytes:
    """Record rows in chunks of the given lengths (the last one repeated); the file's bytes."""
    done, i = 0, 0
    with Recorder(
        folder, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=max(chunks), every=every
    ) as recorder:
        while done < len(rows):
            n = min(chunks[min(i, len(chunks) - 1)], len(rows) - done)
            buffer = recorder.buffer()
            buffer[:n] = rows[done : done + n]
            recorder.submit(buffer, k0 + done, n)
            done, i = done + n, i + 1
    return recorder.path.read_bytes()


@given(
    n=st.integers(0, 60),
    chunks=st.lists(st.integers(1, 20), min_size=1, max_size=6),
    other=st.lists(st.integers(1, 20), min_size=1, max_size=6),
    every=st.integers(1, 12),
    k0=st.integers(0, 30),
)
def test_bytes_do_not_depend_on_the_chunks(
    n: int, chunks: list[int], other: list[int], every: int, k0: int
) -> None:
    rows = signals(n)
    with TemporaryDirectory() as one, TemporaryDirectory() as two:
        a = record(Path(one), rows, chunks, every=every, k0=k0)
        b = record(Path(two), rows, other, every=every, k0=k0)
    assert a == b


@given(
    n=st.integers(0, 60), chunk=st.integers(1, 20), every=st.integers(1, 12), k0=st.integers(0, 30)
)
def test_every_nth_tick_and_the_last_one_are_kept(n: int, chunk: int, every: int, k0: int) -> None:
    rows = signals(n)
    ticks = [k for k in range(k0, k0 + n) if k % every == 0 or k == k0 + n - 1]
    with TemporaryDirectory() as folder:
        record(Path(folder), rows, [chunk], every=every, k0=k0)
        table = pq.read_table(Path(folder) / "trajectories.parquet")
        sizes = pq.ParquetFile(Path(folder) / "trajectories.parquet").metadata
    assert table["t"].to_pylist() == [k * H for k in ticks]
    for column in COLUMNS:
        expected = [rows[k - k0, column.index] for k in ticks]
        assert table[column.name].to_pylist() == expected
    groups_of = [sizes.row_group(i).num_rows for i in range(sizes.num_row_groups)]
    assert groups_of == [8] * (len(ticks) // 8) + [len(ticks) % 8] * (len(ticks) % 8 > 0)


@given(
    lengths=st.lists(st.integers(0, 10), max_size=12),
    n=st.integers(0, 40),
    keep=st.integers(0, 40),
    rows_per_chunk=st.just(10),
)
def test_flight_recorder_holds_the_last_ticks_of_everything(
    lengths: list[int], n: int, keep: int, rows_per_chunk: int
) -> None:
    rows = signals(sum(lengths))
    with TemporaryDirectory() as folder:
        recorder = Recorder(
            folder, COLUMNS[:1], h=H, n_signals=SIGNALS, rows_per_chunk=rows_per_chunk, keep=keep
        )
        done = 0
        for length in lengths:
            buffer = recorder.buffer()
            buffer[:length] = rows[done : done + length]
            recorder.submit(buffer, done, length)
            done += length
        k0, last = recorder.last(n)
        recorder.close()
        again = recorder.last(n)
    assert last.shape[1] == SIGNALS and len(last) <= n
    assert k0 + len(last) == done
    np.testing.assert_array_equal(last, rows[k0:done])
    assert again[0] == k0 and np.array_equal(again[1], last)
    full = all(length >= rows_per_chunk - 1 for length in lengths[:-1])
    if full:
        assert len(last) >= min(n, keep, done)


@given(
    places=st.permutations(range(11)),
    count=st.integers(0, 11),
    n=st.integers(1, 150),
    every=st.integers(1, 3),
    order=st.sampled_from("CF"),
)
def test_columns_are_taken_from_any_places(
    places: list[int], count: int, n: int, every: int, order: Literal["C", "F"]
) -> None:
    """Some at once and those that are left, rows in full tiles and less, whatever their layout."""
    rows = np.asarray(signals(n, 11), order=order)
    columns = [Column(f"c{i}", "1", i) for i in places[:count]]
    with TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "_GROUP_MOST", 64)
        path = Path(folder) / "x.parquet"
        writer = groups.GroupWriter(path, columns, h=H, every=every, start=0.1)
        writer.add(rows, 5, last=True)
        writer.close()
        table = pq.read_table(path)
    ticks = np.array([k for k in range(5, 5 + n) if k % every == 0 or k == 4 + n])
    assert table["t"].to_pylist() == (0.1 + ticks * H).tolist()
    for column in columns:
        assert table[column.name].to_pylist() == rows[ticks - 5, column.index].tolist()


@pytest.mark.parametrize(("ticks", "size"), [(0, 8), (16, 8), (17, 16), (64, 32), (10**6, 32)])
def test_row_groups_of_a_long_recording_are_larger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ticks: int, size: int
) -> None:
    """At most two of them here, and at most 128 values in one; those of a recovery, too."""
    for name, value in (("_MANY", 2), ("_LARGE_VALUES", 128)):
        monkeypatch.setattr(groups, name, value)
    rows = signals(50)
    recorder = Recorder(tmp_path / "run", COLUMNS, h=H, n_signals=SIGNALS, ticks=ticks)
    buffer = recorder.buffer()
    buffer[:50] = rows
    recorder.submit(buffer, 0, 50)
    recorder.settle()
    with pytest.warns(CutShort):
        recovered = Run.open(shutil.copytree(tmp_path / "run", tmp_path / "killed"))
    recorder.close()
    sizes = [size] * (50 // size) + [50 % size]
    for run in (recovered, Run.open(tmp_path / "run")):
        found = run._file.metadata
        assert [found.row_group(i).num_rows for i in range(found.num_row_groups)] == sizes
        assert np.array_equal(run.array("a.q"), rows[:, [2, 0]])


@pytest.mark.parametrize(
    ("columns", "expected", "rows"),
    [(43, 60_001, 1 << 13), (43, 10**6, 1 << 13), (43, 10**7, 1 << 16), (43, 10**8, 1 << 17),
     (3, 10**8, 1 << 17), (3000, 10**8, 1 << 11), (10**5, 10**8, 1 << 10), (0, 10**8, 1 << 17)],
)  # fmt: skip
def test_sizes_of_row_groups(columns: int, expected: int, rows: int) -> None:
    """At most 64 MiB, and at most 800 of them, where that is possible."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(groups, "_GROUP_LEAST", 1 << 10)
        patch.setattr(groups, "_GROUP_MOST", 1 << 16)
        assert groups.group_rows(columns, expected) == rows


def test_flight_recorder_is_saved_with_any_columns(tmp_path: Path) -> None:
    rows = signals(25)
    with Recorder(
        tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=10, every=5, keep=15
    ) as recorder:
        for k0 in (0, 10, 20):
            buffer = recorder.buffer()
            n = min(10, 25 - k0)
            buffer[:n] = rows[k0 : k0 + n]
            recorder.submit(buffer, k0, n)
        everything = [Column(f"v[{i}]", "1", i) for i in range(SIGNALS)]
        recorder.save_last(tmp_path / "last.parquet", 15, everything)
        recorder.save_last(tmp_path / "some.parquet", 2)
    last = Run.open(tmp_path / "last.parquet")
    np.testing.assert_array_equal(last.array("v"), rows[10:])
    np.testing.assert_array_equal(last.t, np.arange(10, 25) * H)
    some = Run.open(tmp_path / "some.parquet")
    assert some.names == tuple(c.name for c in COLUMNS)
    np.testing.assert_array_equal(some.column("b.tau"), rows[23:, 3])


def test_values_that_are_not_finite_come_back_as_they_are(tmp_path: Path) -> None:
    rows = np.array([[np.nan, np.inf, -np.inf, -0.0], [5e-324, 1.8e308, 0.1, 1 / 3]])
    record(tmp_path, rows, [2])
    run = Run.open(tmp_path)
    back = np.column_stack([run.column(c.name) for c in COLUMNS])
    assert back.tobytes() == np.ascontiguousarray(rows[:, [2, 0, 3]]).tobytes()


def test_units_and_settings_are_in_the_schema(tmp_path: Path) -> None:
    with Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, every=5, metadata={"seed": "7"}):
        pass
    schema = pq.read_schema(tmp_path / "trajectories.parquet")
    units = {field.name: field.metadata[b"unit"] for field in schema}
    assert units == {"t": b"s", "a.q[0]": b"rad", "a.q[1]": b"rad", "b.tau": b"N.m"}
    assert schema.metadata[b"h"] == b"0.001"
    assert schema.metadata[b"every"] == b"5"
    assert schema.metadata[b"seed"] == b"7"


def test_buffers_are_few_and_used_again(tmp_path: Path) -> None:
    seen = set()
    with Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=1024) as recorder:
        for k in range(50):
            buffer = recorder.buffer()
            seen.add(id(buffer))
            buffer[0] = k
            recorder.submit(buffer, k, 1)
    assert len(seen) == 8


def test_buffer_waits_until_one_has_been_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, got = threading.Event(), threading.Event()
    add = groups.GroupWriter.add

    def slow(self: groups.GroupWriter, rows: np.ndarray, k0: int, **how: bool) -> None:
        assert gate.wait(60)
        add(self, rows, k0, **how)

    monkeypatch.setattr(groups.GroupWriter, "add", slow)
    with Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=2000) as recorder:
        for k in range(8):
            buffer = recorder.buffer()
            buffer[0] = k
            recorder.submit(buffer, k, 1)

        def ninth() -> None:
            buffer = recorder.buffer()
            got.set()
            buffer[0] = 8
            recorder.submit(buffer, 8, 1)

        thread = threading.Thread(target=ninth)
        thread.start()
        assert not got.wait(0.05)
        gate.set()
        thread.join(60)
    assert Run.open(tmp_path).column("b.tau").tolist() == [*range(9)]


# ---- what fails ----------------------------------------------------------------------------------


def failing(monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """The disk is full from the given chunk on."""
    count = iter(range(10**6))
    add = groups.GroupWriter.add

    def full(self: groups.GroupWriter, rows: np.ndarray, k0: int, **how: bool) -> None:
        if next(count) >= after:
            raise OSError(errno.ENOSPC, "no room")
        add(self, rows, k0, **how)

    monkeypatch.setattr(groups.GroupWriter, "add", full)


def test_full_disk_ends_the_run_with_the_path_and_the_last_ticks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing(monkeypatch, after=1)
    recorder = Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=10, keep=10)
    with pytest.raises(RunError, match=r"trajectories\.parquet: No space left on device") as caught:
        for k in range(0, 10_000, 10):
            buffer = recorder.buffer()
            buffer[:] = k
            recorder.submit(buffer, k, 10)
    assert caught.value.saved == str(tmp_path)
    k0, last = recorder.last(10)
    assert len(last) == 10 and (last == k0).all()
    with pytest.raises(RunError, match="No space left"):
        recorder.close()
    recorder.close()  # said once, that is enough


def test_full_disk_at_the_very_end_is_said_by_close(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: groups.GroupWriter) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(groups.GroupWriter, "close", full)
    with (
        pytest.raises(RunError, match="No space left"),
        Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS),
    ):
        pass


def test_a_real_full_file_system(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")  # not on Windows
    rng = np.random.default_rng(0)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=1000)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, before[1]))
    try:
        with pytest.raises(RunError, match=r"cannot write .*trajectories\.parquet: File too large"):
            for k in range(0, 100_000, 1000):
                buffer = recorder.buffer()
                buffer[:] = rng.normal(size=buffer.shape)
                recorder.submit(buffer, k, 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_stopped_the_run_comes_before_what_the_recorder_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    failing(monkeypatch, after=0)
    with (
        pytest.raises(ZeroDivisionError) as caught,
        Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS) as recorder,
    ):
        recorder.submit(recorder.buffer(), 0, 1)
        raise ZeroDivisionError("the plant")
    assert "No space left on device" in caught.value.__notes__[0]
    assert str(caught.value) == "the plant"


def test_a_run_that_stops_leaves_a_readable_file(tmp_path: Path) -> None:
    with (
        pytest.raises(ZeroDivisionError),
        Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=4) as recorder,
    ):
        buffer = recorder.buffer()
        buffer[:] = signals(4)
        recorder.submit(buffer, 0, 3)
        raise ZeroDivisionError
    assert len(Run.open(tmp_path)) == 3


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(RunError, match=r"cannot write .*file.*trajectories\.parquet: "):
        Recorder(tmp_path / "file" / "run", COLUMNS, h=H, n_signals=SIGNALS)


def test_an_earlier_recording_is_not_overwritten(tmp_path: Path) -> None:
    before = record(tmp_path, signals(5), [5])
    with pytest.raises(RunError, match="File exists"):
        Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS)
    assert (tmp_path / "trajectories.parquet").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"h": 0.0}, "base step 0.0 s, expected one above 0"),
        ({"every": 0}, r"record\.every: found 0, expected 1 or more"),
        ({"n_signals": 3}, "'b.tau' is entry 3 of the signal vector, which has 3"),
        ({"columns": (COLUMNS[0], COLUMNS[0])}, "'a.q.0.' is listed twice"),
        ({"columns": (Column("t", "s", 0),)}, "'t' is listed twice"),
    ],
)
def test_settings_that_cannot_be(tmp_path: Path, change: dict[str, object], sentence: str) -> None:
    arguments: dict[str, object] = {"columns": COLUMNS, "h": H, "n_signals": SIGNALS, **change}
    with pytest.raises(ScenarioError, match=sentence):
        Recorder(tmp_path, **arguments)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_misuse_is_said(tmp_path: Path) -> None:
    with Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=1024) as recorder:
        with pytest.raises(RunError, match="did not provide"):
            recorder.submit(np.zeros((1024, SIGNALS)), 0, 1)
        buffers = [recorder.buffer() for _ in range(8)]
        with pytest.raises(RunError, match="all 8 buffers"):
            recorder.buffer()
        with pytest.raises(RunError, match="found 1025 rows"):
            recorder.submit(buffers[0], 0, 1025)
        recorder.submit(buffers[0], 5, 2)
        with pytest.raises(RunError, match="chunk from tick 8, expected tick 7"):
            recorder.submit(buffers[1], 8, 1)


def test_a_chunk_that_was_not_written_is_not_filled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The engine waits for a chunk when writing it fails: it gets the failure, no row is lost."""
    recorder = Recorder(tmp_path, COLUMNS, h=H, n_signals=SIGNALS, rows_per_chunk=5, keep=0)
    waits, add, free = threading.Event(), recorder._writer.add, recorder._free
    taken = type(free)()

    def fails(rows: np.ndarray, k0: int, **how: bool) -> None:
        if k0 >= 5:
            waits.wait(30)
            raise OSError(errno.ENOSPC, "No space left on device")
        add(rows, k0, **how)

    def put(rows: np.ndarray) -> None:
        taken.put(rows)
        sleep(0.1)  # whoever waits for it goes on now

    monkeypatch.setattr(recorder._writer, "add", fails)
    recorder._free = SimpleNamespace(put=put, get=taken.get)  # type: ignore[assignment]
    while not free.empty():
        taken.put(free.get())
    rows, k0 = signals(100), 0
    with pytest.raises(RunError, match="No space left on device"):
        while True:
            if k0 == 20:
                waits.set()
            buffer = recorder.buffer()
            recorder.begin(buffer, k0)
            buffer[:5] = rows[k0 : k0 + 5]
            recorder.submit(buffer, k0, 5)
            k0 += 5
    with pytest.raises(RunError, match="No space left on device"):
        recorder.close()
    with pytest.warns(CutShort):
        found = Run.open(tmp_path)
    assert np.array_equal(found.t, np.arange(k0) * H)
    assert np.array_equal(found.column("a.q[0]"), rows[:k0, 2])
