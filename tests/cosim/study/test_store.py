"""The folder: whatever is cut off where, no row is lost and none is there twice."""

from __future__ import annotations

import json
from math import inf, isnan, nan
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.base.errors import ScenarioError
from cosim.study import store as stores
from cosim.study.run_point import StudyRow
from cosim.study.store import Store, parts, rows


def made(i: int, **measures: float) -> StudyRow:
    return StudyRow(f"run{i}", {"K": float(i)}, (f"a.K={i}",), True, "", nan, 0.1, measures)


def killed(store: Store) -> None:
    """The end of a store whose process was killed: its file is closed, and nothing is written."""
    store._journal.close()


def filled(folder: Path, numbers: range) -> None:
    with Store(folder, {"e": "rad"}) as store:
        for i in numbers:
            store.append(made(i, e=i / 3))


def test_rows_come_back_as_they_were(tmp_path: Path) -> None:
    with Store(tmp_path, {"e": "rad"}) as store:
        store.append(made(1, e=0.1, settle=inf))
        store.append(made(2, e=nan))
        store.append(StudyRow("run3", {"K": 3.0}, (), False, "diverged", 1.5))
    found = rows(tmp_path)
    assert list(found) == ["run1", "run2", "run3"]
    assert (found["run1"]["e"], found["run1"]["settle"], found["run1"]["K"]) == (0.1, inf, 1.0)
    assert isnan(found["run2"]["e"])
    assert found["run3"]["e"] is None
    assert (found["run3"]["reason"], found["run3"]["stopped_at"]) == ("diverged", 1.5)
    assert json.loads(found["run1"]["settings"]) == ["a.K=1"]
    (part,) = parts(tmp_path)
    assert pq.read_schema(part).field("e").metadata == {b"unit": b"rad"}


def failed(i: int, wall: float) -> StudyRow:
    return StudyRow(f"run{i}", {"K": float(i)}, (), False, "no memory", nan, wall)


@pytest.mark.parametrize("flushed", [False, True])
def test_a_run_that_failed_may_be_made_again(tmp_path: Path, flushed: bool) -> None:
    with Store(tmp_path, {}) as store:
        store.append(failed(1, 0.25))
        store.append(made(2, e=0.5))
        if flushed:
            store.flush()
        assert (store.done, store.failed) == ({"run1", "run2"}, {"run1"})
        store.append(failed(1, 0.75))
        assert store.failed == {"run1"}
        store.append(made(1, e=0.1))
        assert store.failed == set()
    with Store(tmp_path, {}) as store:
        assert (store.done, store.failed) == ({"run1", "run2"}, set())
    found = rows(tmp_path)
    assert (found["run1"]["e"], found["run2"]["e"], len(found)) == (0.1, 0.5, 2)


def test_killed_after_a_second_try_its_row_counts(tmp_path: Path) -> None:
    with Store(tmp_path, {}) as store:
        store.append(failed(1, 0.25))
    store = Store(tmp_path, {})
    store.append(made(1, e=0.1))  # and no end: the journal has it, the part has the old one
    killed(store)
    with Store(tmp_path, {}) as again:
        assert (again.done, again.failed) == ({"run1"}, set())
    assert rows(tmp_path)["run1"]["e"] == 0.1


def test_parts_are_only_ever_added(tmp_path: Path) -> None:
    filled(tmp_path, range(3))
    before = [p.read_bytes() for p in parts(tmp_path)]
    filled(tmp_path, range(3, 5))
    assert [p.name for p in parts(tmp_path)] == ["part-00000.parquet", "part-00001.parquet"]
    assert parts(tmp_path)[0].read_bytes() == before[0]
    assert (tmp_path / "journal.jsonl").read_bytes() == b""


def test_a_long_journal_becomes_a_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "PART_ROWS", 4)
    filled(tmp_path, range(10))
    assert [len(pq.read_table(p)) for p in parts(tmp_path)] == [4, 4, 2]


@given(cut=st.integers(0, 2000))
def test_a_journal_cut_anywhere_keeps_its_whole_rows(tmp_path_factory, cut: int) -> None:
    folder = tmp_path_factory.mktemp("cut")
    store = Store(folder, {})
    for i in range(6):
        store.append(made(i))
    killed(store)
    whole = (folder / "journal.jsonl").read_bytes()
    (folder / "journal.jsonl").write_bytes(whole[:cut])
    with Store(folder, {}) as again:
        left = whole[:cut].count(b"\n")
        assert again.done == {f"run{i}" for i in range(left)}
        again.append(made(99))
    assert list(rows(folder)) == [*(f"run{i}" for i in range(left)), "run99"]


def test_killed_between_the_part_and_the_journal_no_row_is_there_twice(tmp_path: Path) -> None:
    store = Store(tmp_path, {})
    for i in range(3):
        store.append(made(i))
    kept = (tmp_path / "journal.jsonl").read_bytes()
    store.flush()
    killed(store)
    (tmp_path / "journal.jsonl").write_bytes(kept)
    filled(tmp_path, range(3, 5))
    assert sum(len(pq.read_table(p)) for p in parts(tmp_path)) == 5
    assert len(rows(tmp_path)) == 5


def test_a_half_written_part_is_not_a_part(tmp_path: Path) -> None:
    filled(tmp_path, range(3))
    (tmp_path / "results" / ".part-00001.parquet.123").write_bytes(b"PAR1")
    filled(tmp_path, range(3, 4))
    assert len(rows(tmp_path)) == 4


def test_columns_are_numbers_truths_or_text(tmp_path: Path) -> None:
    rows_ = [{"a": 1, "b": True, "c": "x", "settings": ""}, {"a": 2.5, "c": 3, "settings": ""}]
    stores.write_table(tmp_path / "t.parquet", rows_, {})
    assert pq.read_table(tmp_path / "t.parquet").to_pydict() == {
        "a": [1.0, 2.5], "b": [True, None], "c": ["x", "3"], "settings": ["", ""],
    }  # fmt: skip


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    filled(tmp_path, range(3))
    parts(tmp_path)[0].write_bytes(b"nonsense")
    with pytest.raises(ScenarioError, match=r"part-00000.parquet: not a part of a sweep"):
        rows(tmp_path)
