"""Tables in files: the same bytes for the same rows, replay, and files that are refused."""

from __future__ import annotations

import errno
from io import FileIO
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.links import storage
from cosim.links.laws import Constant, Uniform
from cosim.links.semantics import Grid, PacketSemantics, PlayoutSemantics, SignalSemantics
from cosim.links.storage import GROUP, TableWriter, load_table, open_table
from cosim.links.table import DrawnTable
from tests.cosim.links.stored import save_table

GRID = Grid(2, 3, 0.005)
TABLE = DrawnTable("a->b", GRID, Uniform(0.05, 0.4, 0.03), PacketSemantics("last-arrival"), 11)
FACTS = {"name": "x", "sender_period": 2, "receiver_period": 3, "h": 0.005}


def write(path, rows, facts=FACTS):
    with TableWriter(path, facts) as writer:
        writer.write(rows)
    return path


def test_a_table_comes_back_with_its_facts(tmp_path):
    save_table(tmp_path / "t.parquet", TABLE, 5000)
    facts, rows = load_table(tmp_path / "t.parquet")
    assert rows.dtype == np.int32
    assert rows.tolist() == TABLE.stream().rows(5000).tolist()
    assert facts == TABLE.facts()
    assert facts["delay"] == {"law": "uniform", "low": 0.05, "high": 0.4, "hold": 0.03}
    assert (facts["semantics"], facts["seed"], facts["h"]) == ("last-arrival", 11, 0.005)


@settings(max_examples=15)
@given(cuts=st.lists(st.integers(0, GROUP + 2000), max_size=6))
@example(cuts=[GROUP - 1, GROUP, GROUP + 1])
def test_the_bytes_do_not_depend_on_how_the_rows_came(tmp_path_factory, cuts):
    folder = tmp_path_factory.mktemp("bytes")
    n = GROUP + 2000
    save_table(folder / "a.parquet", TABLE, n)
    rows, cuts = TABLE.stream().rows(n), sorted(cuts)
    with TableWriter(folder / "b.parquet", TABLE.facts()) as writer:
        for start, stop in zip([0, *cuts], [*cuts, n], strict=True):
            writer.write(rows[start:stop])
    assert (folder / "a.parquet").read_bytes() == (folder / "b.parquet").read_bytes()


def test_any_reader_sees_one_column_of_int32(tmp_path):
    save_table(tmp_path / "t.parquet", TABLE, GROUP + 10)
    file = pq.ParquetFile(tmp_path / "t.parquet")
    assert [str(t) for t in file.schema_arrow.types] == ["int32"]
    assert file.metadata.num_row_groups == 2
    assert (tmp_path / "t.parquet").stat().st_size < 2 * GROUP  # packed: far under 4 bytes a row


@pytest.mark.parametrize(
    "rule",
    [
        SignalSemantics(),
        PacketSemantics("last-arrival"),
        PacketSemantics("newest-stamp"),
        PlayoutSemantics(0.2),
    ],
)
def test_a_stored_table_replays(tmp_path, rule):
    """Same rows in any chunks; its own facts comply with those that were declared."""
    drawn = DrawnTable("a->b", GRID, Uniform(0.05, 0.4, 0.03), rule, 1)
    save_table(tmp_path / "t.parquet", drawn, 4000)
    stored = open_table(tmp_path / "t.parquet", name="again", grid=GRID)
    stream = stored.stream(4000)
    rows = np.concatenate([stream.rows(n) for n in (0, 1, 999, 3000)])
    assert rows.tolist() == drawn.stream().rows(4000).tolist()
    assert 0 <= drawn.minimum_delay_ticks <= stored.minimum_delay_ticks
    assert 0 < stored.history <= drawn.history
    facts = stored.facts()
    assert (facts["name"], facts["replay"], facts["seed"]) == ("again", "t.parquet", 1)


def test_a_replay_can_be_stored_and_replayed_again(tmp_path):
    save_table(tmp_path / "a.parquet", TABLE, GROUP + 5)
    first = open_table(tmp_path / "a.parquet", name="a->b", grid=GRID)
    save_table(tmp_path / "b.parquet", first, GROUP + 5)
    second = open_table(tmp_path / "b.parquet", name="a->b", grid=GRID)
    assert (second.history, second.minimum_delay_ticks) == (
        first.history,
        first.minimum_delay_ticks,
    )
    assert np.array_equal(second.stream().rows(GROUP + 5), first.stream().rows(GROUP + 5))


def test_held_rows_need_no_history(tmp_path):
    """Sample 0 held for ever gets old, but was new once: nothing has to be kept for it."""
    path = write(tmp_path / "t.parquet", [-1, -1, 0, *[0] * 1000])
    stored = open_table(path, name="x", grid=GRID)
    assert (stored.history, stored.minimum_delay_ticks) == (6 // 2 + 1, 6)


def test_a_table_that_never_received_is_no_wire(tmp_path):
    stored = open_table(write(tmp_path / "t.parquet", [-1] * 9), name="x", grid=GRID)
    assert stored.minimum_delay_ticks > 0
    assert stored.stream(9).rows(9).tolist() == [-1] * 9


def test_a_run_longer_than_the_file_is_refused(tmp_path):
    stored = open_table(write(tmp_path / "t.parquet", [0, 1, 2]), name="x", grid=GRID)
    with pytest.raises(ScenarioError, match=r"t.parquet: 3 rows, the run needs 4"):
        stored.stream(4)
    stream = stored.stream(3)
    stream.rows(3)
    with pytest.raises(RunError, match="rows 3 to 4 of a link table opened for 3"):
        stream.rows(1)


@pytest.mark.parametrize(
    "rows, message",
    [
        ([0, 1, 4], r"t.parquet: row 2: holds sample 4, but 4 samples are sent by then"),
        ([0, -2], r"t.parquet: row 1: holds sample -2"),
    ],
)
def test_rows_that_cannot_be_are_refused(tmp_path, rows, message):
    with pytest.raises(ScenarioError, match=message):
        open_table(write(tmp_path / "t.parquet", rows), name="x", grid=GRID)


def test_files_that_are_no_table_of_this_link_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match=r"none.parquet: no such file"):
        open_table(tmp_path / "none.parquet", name="x", grid=GRID)
    (tmp_path / "a.parquet").write_text("sent\n1\n")
    with pytest.raises(ScenarioError, match=r"a.parquet: not a Parquet file"):
        load_table(tmp_path / "a.parquet")
    pq.write_table(pa.table({"sent": pa.array([1], pa.int32())}), tmp_path / "b.parquet")
    with pytest.raises(ScenarioError, match=r"b.parquet: columns sent; expected a link table"):
        load_table(tmp_path / "b.parquet")
    path = write(tmp_path / "c.parquet", [0])
    for grid in (Grid(1, 3, 0.005), Grid(2, 3, 0.001)):
        with pytest.raises(ScenarioError, match=r"stored for periods of 2 and 3 ticks of 0.005 s"):
            open_table(path, name="x", grid=grid)


def test_a_table_without_rows_is_a_table(tmp_path):
    facts, rows = load_table(write(tmp_path / "t.parquet", []))
    assert (facts["name"], rows.size, rows.dtype) == ("x", 0, np.int32)


def test_what_was_written_before_an_error_is_kept(tmp_path):
    with pytest.raises(ZeroDivisionError), TableWriter(tmp_path / "t.parquet", FACTS) as writer:
        writer.write([0, 1])
        raise ZeroDivisionError
    assert load_table(tmp_path / "t.parquet")[1].tolist() == [0, 1]


def test_runs_that_do_not_count_in_int32_are_refused():
    for grid, length in [(Grid(1, 1, 0.005), 2**31), (Grid(1, 4, 0.005), 2**30)]:
        table = DrawnTable("x", grid, Constant(0.1), SignalSemantics(), 0)
        with pytest.raises(ScenarioError, match="expected at most 2147483647; stop the run"):
            table.stream(length)
    with pytest.raises(ScenarioError, match="a delay of 1e\\+12 s is more than 2147483647 ticks"):
        DrawnTable("x", GRID, Constant(1e12), SignalSemantics(), 0)


def test_a_table_that_cannot_be_begun_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of rows without its first line would be unreadable, and the folder with it."""

    def full(file: FileIO, data: bytes) -> None:
        file.write(data[:3])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(storage, "_write_all", full)
    with pytest.raises(RunError, match="No space left on device"):
        storage.TableWriter(tmp_path / "x.parquet", {"name": "x"})
    assert not list(tmp_path.iterdir())
