"""The files of a sweep: the same whether they are written at once or in pieces."""

from __future__ import annotations

import csv
from math import nan
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from cosim.study import store, summary
from cosim.study.table import Records, SweepTable, grouped, groups


def made(n: int, axes: tuple[str, ...] = ("gain", "law", "seed")) -> SweepTable:
    """`n` runs whose seeds are the slowest axis, so that runs of a point are not side by side."""
    i = np.arange(n)
    columns = {
        "run": np.array([f"{k:x}" for k in i], dtype=object),
        "stable": i % 3 > 0,
        "reason": np.array(["", "", "", "diverged"] * n, dtype=object)[:n],
        "gain": np.array([[1.5, 2, 10.0][k % 3] for k in i], dtype=object),
        "law": np.array(["hold", "other"] * n, dtype=object)[:n],
        "seed": np.array((i // 6).tolist(), dtype=object),
        "error": np.where(i % 4 == 3, nan, np.sin(i)),
        "settings": np.array(["[]"] * n, dtype=object),
    }
    return SweepTable(axes, {"error": "rad"}, Records(columns, {"error": i % 4 == 3}), n)


def test_groups_are_in_the_order_of_the_table() -> None:
    table = made(16)
    rows, ends = grouped(table.records, ["gain", "law"])
    expected: dict[tuple[object, object], list[int]] = {}
    for k, record in enumerate(table.records):
        expected.setdefault((record["gain"], record["law"]), []).append(k)
    assert [some.tolist() for some in np.split(rows, ends[:-1])] == list(expected.values())
    found = groups(table, ["gain", "law"])
    assert list(found) == list(expected)
    assert [[r["run"] for r in some] for some in found.values()] == [
        [f"{k:x}" for k in some] for some in expected.values()
    ]
    assert [x.tolist() for x in grouped(table.records, [])] == [list(range(16)), [16]]
    assert [len(x) for x in grouped(made(0).records, ["gain"])] == [0, 0]


def test_files_in_pieces_are_those_written_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = made(40)
    (tmp_path / "a").mkdir()
    summary.write(table, tmp_path / "a")
    monkeypatch.setattr(summary, "AT_ONCE", 2)
    monkeypatch.setattr(store, "GROUP_ROWS", 7)
    (tmp_path / "b").mkdir()
    summary.write(table, tmp_path / "b")
    whole, pieces = ((tmp_path / x / "summary.csv").read_bytes() for x in "ab")
    assert whole == pieces and sorted(p.name for p in (tmp_path / "b").iterdir()) == [
        "summary.csv", "table.parquet",
    ]  # fmt: skip
    files = [pq.ParquetFile(tmp_path / x / "table.parquet") for x in "ab"]
    assert [file.num_row_groups for file in files] == [1, 6]
    assert files[0].read().equals(files[1].read())
    assert files[1].schema_arrow.field("error").metadata == {b"unit": b"rad"}
    first = next(iter(csv.DictReader(whole.decode().splitlines())))
    errors = np.array([np.sin(k) for k in range(0, 40, 6) if k % 4 != 3])
    assert (first["gain"], first["law"], first["runs"]) == ("1.5", "hold", "7")
    assert float(first["error"]) == pytest.approx(errors.mean())
    assert (float(first["error.least"]), float(first["error.largest"])) == (
        errors.min(), errors.max(),
    )  # fmt: skip


def test_many_points_with_one_run_each_have_no_summary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(summary, "MANY", 5)
    few, many, seeds = made(5, ("gain",)), made(6, ("gain",)), made(6)
    names = [[p.name for p in summary.write(x, tmp_path)] for x in (few, seeds)]
    assert names == [["table.parquet", "summary.csv"]] * 2
    assert [p.name for p in summary.write(many, tmp_path)] == ["table.parquet"]
    assert not (tmp_path / "summary.csv").exists()  # that of fewer points
