"""A few golden digests, fast enough for every run of the tests; differences are noticed."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.golden.kept import Record, differences, same, settled, table
from tests.golden.run import CASES, FILE, case, frozen

FAST = ("run constant", "run fmi3", "fault corrupt", "refusals")


@pytest.mark.parametrize("name", FAST)
def test_nothing_has_changed(name):
    assert list(differences(frozen()[name], case(name))) == []


def test_every_case_is_frozen_and_no_other():
    assert list(frozen()) == list(CASES)
    assert '"commit": "' in FILE.read_text(encoding="utf-8")


def test_differences_are_named():
    was = {"a": "1", "b": [1.0, "nan"], "c": "gone"}
    now = {"a": "2", "b": [1.0, "nan"], "d": "new"}
    assert list(differences(was, now)) == [
        "a: was '1', is '2'", "c: is no longer there", "d: is new",
    ]  # fmt: skip


def test_numbers_have_a_tolerance_and_bits_have_none(tmp_path):
    assert same([1.0, 0.0], [1.0 + 1e-12, 1e-14]) and not same([1.0], [1.0 + 1e-6])
    assert not same([1.0], [1.0, 1.0]) and not same([1.0], ["nan"])
    record = Record(tmp_path)
    record.array("a", np.array([1.0]))
    record.array("b", np.nextafter(np.array([1.0]), 2.0))
    assert record.kept["a"] != record.kept["b"]


def test_a_table_is_its_values_not_how_they_are_stored(tmp_path):
    columns = {"t": [0.0, 1.0], "name": ["a", None]}
    paths = [tmp_path / n for n in ("a", "b", "c")]
    pq.write_table(pa.table(columns), paths[0])
    pq.write_table(pa.table(dict(reversed(columns.items()))), paths[1], compression="gzip")
    pq.write_table(pa.table(columns | {"t": [0.0, 1.5]}), paths[2])
    first, second, third = map(table, paths)
    assert first == second != third


def test_texts_are_without_places_and_times(tmp_path):
    text = f"wall time     0.21 s for 2 s: 9.5 x real time\nrun folder  {tmp_path}/run  "
    assert settled(text, tmp_path) == "wall time     <time>\nrun folder  <folder>/run"
