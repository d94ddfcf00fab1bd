"""The runs of a study as the page has them: every value and every command."""

from __future__ import annotations

import base64
import json
from math import inf, isnan, nan

import numpy as np

from cosim.reporting.points import PointColumn, PointView, points

VIEW = PointView("title", "gain", "law", "</script>")


def columns(count: int) -> list[PointColumn]:
    gain = PointColumn("gain", "", [0.5] * (count - 1) + [2], axis=True, parallel=True, listed=True)
    laws = ["b"] * (count - 1) + ["a"]
    law = PointColumn("law", "", laws, axis=True, parallel=True, listed=True)
    values = [nan] * (count - 1) + [inf]
    return [gain, law, PointColumn("time", "s", values, axis=False, parallel=True, listed=True)]


def decoded(text: str, kind: str) -> list[float]:
    return np.frombuffer(base64.b64decode(text), kind).tolist()


def test_columns_reasons_and_settings_are_read_back() -> None:
    settings = [["run.stop=4", "a.b=0.5"], ["run.stop=4", "a.b=0.5"], ["run.stop=4", "a.b=2"]]
    text = points(columns(3), [VIEW], ["", "", "why"], repeat="cosim run x", settings=settings)
    assert "</script>" not in text
    page = json.loads(text)
    gain, law, time = page["columns"]
    assert decoded(gain["values"], "<f4") == [0.5, 0.5, 2.0]
    assert [law["labels"][int(i)] for i in decoded(law["values"], "<u2")] == ["b", "b", "a"]
    first, _, last = decoded(time["values"], "<f4")
    assert isnan(first) and last == inf
    assert [page["reasons"][i] for i in page["why"]] == ["", "", "why"]
    places = [(s["start"], s["ends"], decoded(s["index"], "<u2")) for s in page["settings"]]
    again = [[start + ends[int(index[i])] for start, ends, index in places] for i in range(3)]
    assert (page["command"], again) == ("cosim run x", settings)


def test_folders_that_were_kept_replace_commands() -> None:
    text = points(columns(2), [VIEW], ["", ""], folders=["r1", "r2"], repeat="x", settings=[[], []])
    page = json.loads(text)
    assert page["folders"] == ["r1", "r2"] and "command" not in page


def test_settings_that_are_too_many_are_left_to_the_table() -> None:
    count = 20_000
    settings = [[f"a.b={i}{0:055d}"] for i in range(count)]
    page = json.loads(points(columns(count), [VIEW], [""] * count, repeat="x", settings=settings))
    assert page["count"] == count and "command" not in page
