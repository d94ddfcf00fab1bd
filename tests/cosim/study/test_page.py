"""The report of a sweep: which measures are in the table of runs and filter it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from cosim.study.page import PARALLEL, write
from cosim.study.study import load_study
from cosim.study.table import SweepTable
from tests.cosim.study.studies import STUDY, written

ASKED = """values = [1, 2]
[stable]
"end.max" = 1.0
[figures.time]
kind = "line"
x = "gain"
y = "last.settle_s"
"""


def columns(folder: Path, more: int) -> dict[str, dict[str, Any]]:
    """The columns of the page of two runs with `more` measures that the study does not name."""
    study = load_study(written(folder, STUDY + ASKED))
    others = [f"m{i}" for i in range(more)]
    units = dict.fromkeys([*others, "m0.part", "end", "end.max", "last", "last.settle_s"], "rad")
    record = {"run": "r", "stable": True, "reason": "", "settings": "[]", **dict.fromkeys(units, 1)}
    axes = tuple(axis.name for axis in study.axes)
    records = [{**record, **dict.fromkeys(axes, a)} for a in (1.0, 2.0)]
    text = write(SweepTable(axes, units, records, 2), study, folder, "cosim sweep")
    found = re.search(r'id="points">(.*?)</script>', text.read_text(encoding="utf-8"))
    assert found is not None
    return {column["name"]: column for column in json.loads(found[1])["columns"]}


def test_measures_that_the_study_names_are_columns_and_filters(tmp_path: Path) -> None:
    """Also parts of measures, and where there are more measures than axes beside each other."""
    found = columns(tmp_path, PARALLEL + 3)
    measures = [name for name, column in found.items() if not column["axis"]]
    assert measures[:3] == ["stable", "end.max", "last.settle_s"]
    for name in ("end.max", "last.settle_s"):
        assert found[name]["listed"] and found[name]["parallel"]
    assert not found["m0.part"]["listed"] and not found["m0.part"]["parallel"]
    assert found["m0"]["parallel"] and not found[f"m{PARALLEL}"]["parallel"]
    assert found[f"m{PARALLEL}"]["listed"]
    assert sum(column["parallel"] for column in found.values()) == PARALLEL
