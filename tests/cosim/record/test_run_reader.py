"""Run: recorded data is read back by name, or an error gives the reason."""

from __future__ import annotations

import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import RunError, ScenarioError
from cosim.record import Column, Recorder, Run, link_file, write_metadata

NAMES = {
    "m.q[0]": "rad", "m.q[10]": "rad", "m.q[2]": "rad",
    "m.xi_in[0,0]": "rad/s", "m.xi_in[1,0]": "rad/s", "m.xi_in[0,1]": "rad/s",
    "m.q_d[0]": "rad", "m.w": "1/s", "m.mixed[0]": "m", "m.mixed[1]": "rad",
}  # fmt: skip


def write(folder: Path, rows: np.ndarray, names: dict[str, str] = NAMES, h: float = 0.1) -> Run:
    columns = [Column(name, unit, i) for i, (name, unit) in enumerate(names.items())]
    chunk = max(1, len(rows))
    with Recorder(folder, columns, h=h, n_signals=len(names), rows_per_chunk=chunk) as recorder:
        buffer = recorder.buffer()
        buffer[: len(rows)] = rows
        recorder.submit(buffer, 0, len(rows))
    return Run.open(folder)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return write(tmp_path, np.arange(30.0).reshape(3, 10))


@given(
    st.integers(0, 40),
    st.lists(st.floats(width=64), min_size=3, max_size=3),
    st.floats(1e-9, 1e3),
)
def test_round_trip(n: int, values: list[float], h: float) -> None:
    rows = np.outer(np.ones(n), values)
    with TemporaryDirectory() as folder:
        run = write(Path(folder), rows, {"a": "1", "b.c": "N.m", "b.d[0]": "kg.m2"}, h)
        assert len(run) == n and run.names == ("a", "b.c", "b.d[0]")
        assert run.units == {"t": "s", "a": "1", "b.c": "N.m", "b.d[0]": "kg.m2"}
        assert run.t.tolist() == [k * h for k in range(n)]
        for i, name in enumerate(run.names):
            assert run.column(name).tobytes() == np.ascontiguousarray(rows[:, i]).tobytes()


def test_entries_come_in_the_order_of_their_indices(run: Run) -> None:
    assert run.entries("m.q") == ("m.q[0]", "m.q[2]", "m.q[10]")
    assert run.array("m.q")[0].tolist() == [0, 2, 1]
    assert run.entries("m.xi_in") == ("m.xi_in[0,0]", "m.xi_in[0,1]", "m.xi_in[1,0]")
    assert run.array("m.q_d").shape == (3, 1)


def test_a_scalar_or_an_entry_is_an_array_of_one(run: Run) -> None:
    assert run.array("m.w").tolist() == [[7], [17], [27]]
    assert run.array("m.q[10]").tolist() == [[1], [11], [21]]


def test_arrays_cannot_be_changed_by_accident(run: Run) -> None:
    for values in (run.t, run.column("m.w"), run.array("m.q")):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1


def test_units(run: Run) -> None:
    assert run.unit("m.xi_in") == "rad/s"
    assert run.unit("m.w") == "1/s"
    with pytest.raises(ScenarioError, match=r"m\.mixed\S* is in \[\w+\] but m\.mixed\S* is in"):
        run.unit("m.mixed")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("m.qq", "did you mean 'm.q'"),
        ("m.q[1]", "did you mean 'm.q"),
        ("M.xi_in", "did you mean 'm.xi_in'"),
        ("nothing like it", "recorded are m.q, m.xi_in"),
    ],
)
def test_an_unknown_name_gets_the_nearest_ones(run: Run, name: str, hint: str) -> None:
    for read in (run.column, run.array, run.unit):
        with pytest.raises(ScenarioError) as caught:
            read(name)
        assert f"no signal {name!r} was recorded" in str(caught.value)
        assert hint in str(caught.value)


def test_metadata_properties_and_links(run: Run, tmp_path: Path) -> None:
    assert run.metadata == {} and run.link_tables == {}
    write_metadata(tmp_path, {"seed": 3})
    path = link_file(tmp_path, "a.xi -> b.xi_in[0]")
    path.write_text("")
    assert run.metadata == {"seed": 3} and run.metadata is run.metadata
    write_metadata(tmp_path, {"seed": 44})
    assert run.metadata == {"seed": 44}
    assert run.link_tables == {"a.xi -> b.xi_in[0]": path}
    assert run.properties["h"] == "0.1"


def test_what_was_recorded_can_be_asked_for(run: Run) -> None:
    assert run.has("m.q") and run.has(next(iter(NAMES)))
    assert not run.has("m") and not run.has("m.qq") and not run.has("m.q[9]")


@pytest.mark.parametrize(("ahead", "reads"), [(1 << 20, 1), (3 * 8 * 50, 4), (0, 10)])
def test_columns_are_read_together_as_long_as_they_are_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ahead: int, reads: int
) -> None:
    rows = np.random.default_rng(1).normal(size=(50, 10))
    monkeypatch.setattr("cosim.record.run.AHEAD", ahead)
    run = write(tmp_path, rows)
    read, asked = run._file.read, list[list[str]]()

    def counted(columns: list[str], **given: bool) -> Any:
        asked.append(columns)
        return read(columns=columns, **given)

    run._file = SimpleNamespace(metadata=run._file.metadata, read=counted)
    columns = [run.column(name) for name in NAMES]
    np.testing.assert_array_equal(np.column_stack(columns), rows)
    assert len(asked) == reads
    assert sorted(name for names in asked for name in names if name != "t") == sorted(NAMES)


def test_a_long_run_keeps_the_columns_used_last_that_fit_into_a_piece(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cosim.record.run.PIECE", 4 * len(run))  # of 11 columns
    read: list[str] = []
    reads = run._file.read_row_groups

    def noted(groups: Any, columns: list[str], **more: Any) -> Any:
        read.extend(columns)
        return reads(groups, columns=columns, **more)

    run._file = SimpleNamespace(
        metadata=run._file.metadata, num_row_groups=1, read_row_groups=noted
    )
    for name, first in (("m.q", 0.0), ("m.q", 0.0), ("m.w", 7.0), ("m.q_d", 6.0), ("m.q", 0.0)):
        [piece] = run.pieces([name])
        assert piece.array(name)[0, 0] == first and piece.t.tolist() == [0.0, 0.1, 0.2]
        assert not piece.t.flags.writeable
    assert run.span == (0.0, 0.2)
    q = ["m.q[0]", "m.q[2]", "m.q[10]"]
    assert read == ["t", *q, "m.w", "m.q_d[0]", *q[:2]]
    assert [len(x.t) for x in run.pieces(["m.w", "m.q"])] == [3]  # of more than a piece has
    assert not [*run.pieces(["m.w"], 0.3)] and len([*run.pieces(["t"], 0.2)]) == 1


def test_csv_reads_back_exactly(tmp_path: Path) -> None:
    rows = np.random.default_rng(1).normal(size=(50, 10)) * 10.0 ** np.arange(-20, 20, 4)
    run = write(tmp_path, rows)
    path = run.to_csv(tmp_path / "run.csv")
    with open(path, newline="") as file:
        header, *lines = csv.reader(file)
    assert header == ["t", *NAMES]
    np.testing.assert_array_equal(np.array(lines, dtype=float)[:, 1:], rows)
    np.testing.assert_array_equal(np.array(lines, dtype=float)[:, 0], run.t)


def test_csv_that_cannot_be_written(run: Run, tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"cannot write .*run\.csv: No such file"):
        run.to_csv(tmp_path / "gone" / "run.csv")


def test_no_run_there(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="gone: there is no such run folder"):
        Run.open(tmp_path / "gone")
    with pytest.raises(ScenarioError, match=r"no trajectories\.parquet in this folder"):
        Run.open(tmp_path)


def test_a_file_that_was_cut_short(run: Run, tmp_path: Path) -> None:
    data = run.path.read_bytes()
    for size in (0, 3, len(data) // 2, len(data) - 1):
        run.path.write_bytes(data[:size])
        with pytest.raises(ScenarioError, match=r"trajectories\.parquet: not a complete Parquet"):
            Run.open(tmp_path)


@pytest.mark.parametrize("where", ["unit", "property"])
def test_a_file_whose_texts_are_no_texts_is_refused(where: str, run: Run, tmp_path: Path) -> None:
    table = pq.read_table(run.path)
    if where == "unit":
        fields = [field.with_metadata({b"unit": b"\xff rad"}) for field in table.schema]
        table = table.cast(pa.schema(fields))
    else:
        table = table.replace_schema_metadata({b"made by": b"\xfe\xff"})
    place = tmp_path / "other.parquet"
    pq.write_table(table, place)
    with pytest.raises(ScenarioError, match=r"other\.parquet: found .*; expected UTF-8"):
        Run.open(place)
