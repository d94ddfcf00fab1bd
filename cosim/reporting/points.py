"""The runs of a study on a page: a map, axes beside each other that filter, and a sortable table.

The page shows any column over any two others; it holds every run, so that ten thousand take about
two megabytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cosim.reporting.html import command, embedded, packed

#: Distinct texts of a column at most: their numbers have 16 bits.
TEXTS = 1 << 16
#: Characters of settings at most; where there are more, runs have no command on the page.
MOST = 1_000_000


@dataclass(frozen=True, slots=True)
class PointColumn:
    """A column: `values` of all runs, numbers (NaN: none, infinity: never) or texts.

    `axis`: what was varied, else what was measured; `parallel`: has an axis beside the others;
    `listed`: stands in the table.
    """

    name: str
    unit: str
    values: Sequence[Any]
    axis: bool
    parallel: bool
    listed: bool

    def data(self) -> dict[str, Any]:
        """The data that the page reads."""
        facts = {
            "name": self.name, "unit": self.unit, "axis": self.axis, "parallel": self.parallel,
            "listed": self.listed,
        }  # fmt: skip
        if any(isinstance(v, str) for v in self.values):
            labels, index = _coded([str(v) for v in self.values])
            return {**facts, "labels": labels, "values": packed(index, "<u2")}
        return {**facts, "values": packed(np.array(self.values, np.float64), "<f4")}


@dataclass(frozen=True, slots=True)
class PointView:
    """A picture to begin with: `z` as colour over the columns `x` and `y`."""

    title: str
    x: str
    y: str
    z: str
    reduce: str = "mean"

    def data(self) -> dict[str, str]:
        """The data that the page reads."""
        return {"title": self.title, "x": self.x, "y": self.y, "z": self.z, "reduce": self.reduce}


def points(
    columns: Sequence[PointColumn],
    views: Sequence[PointView],
    reasons: Sequence[str],
    *,
    folders: Sequence[str] = (),
    repeat: str = "",
    settings: Sequence[Sequence[str]] = (),
) -> str:
    """The runs as JSON for :func:`cosim.reporting.html.write_page`.

    `reasons`: why each run stopped, or empty; `folders`: of the runs, in ``runs/`` beside the page,
    if they were kept; `repeat`: the command of a run, to which its `settings` are added.
    """
    texts, why = _coded(reasons)
    document: dict[str, Any] = {
        "count": len(reasons), "columns": [c.data() for c in columns],
        "views": [v.data() for v in views], "reasons": texts, "why": why.tolist(),
    }  # fmt: skip
    if folders:
        document["folders"] = list(folders)
    elif repeat and (found := _settings(settings)) is not None:
        document |= {"command": repeat, "settings": found}
    return embedded(document)


def _settings(settings: Sequence[Sequence[str]]) -> list[dict[str, Any]] | None:
    """The settings of all runs by their place in the list; None where there are too many."""
    if len({len(s) for s in settings}) != 1:
        return None
    coded = [_coded(place) for place in zip(*settings, strict=True)]
    starts = [_common_start(texts) for texts, _ in coded]
    if any(len(texts) == TEXTS for texts, _ in coded):
        return None
    found = [
        {"start": start, "ends": [text[len(start) :] for text in texts], "index": packed(i, "<u2")}
        for start, (texts, i) in zip(starts, coded, strict=True)
    ]
    return found if sum(len(end) for s in found for end in s["ends"]) <= MOST else None


def _common_start(texts: Sequence[str]) -> str:
    """The common beginning of texts: the first and the last in order agree the least."""
    first, last = min(texts), max(texts)
    equal = next((i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b), None)
    return first[:equal]


def _coded(texts: Sequence[str]) -> tuple[list[str], np.ndarray[Any, Any]]:
    """Distinct texts, and the number of each text among them, (n,)."""
    numbers: dict[str, int] = {}
    index = np.array([numbers.setdefault(text, len(numbers)) for text in texts], np.int64)
    return list(numbers)[:TEXTS], np.minimum(index, TEXTS - 1)


def elements(legend: Mapping[str, str]) -> str:
    """The elements of the page that the runs are drawn in. `legend`: of reductions, by name."""
    options = "".join(f'<option value="{key}">{text}</option>' for key, text in legend.items())
    return (
        '<section aria-label="Map of the runs"><div class="choices" id="views"></div>'
        '<div class="choices"><label>x <select id="map-x"></select></label><label>y '
        '<select id="map-y"></select></label><label>colour <select id="map-z"></select></label>'
        f'<label>of a cell <select id="map-reduce">{options}</select></label></div>'
        '<div><canvas id="map" role="img" aria-label="The chosen column over two others; the same '
        'numbers are in the table below"></canvas></div><p id="said" aria-live="polite"></p>'
        f'<div id="chosen-run" hidden><h2>Run this point again</h2>{command("one", "")}</div>'
        "<div class='together'><h2>Filter</h2><p>Drag along an axis, or type limits; every line is "
        'a run, dashed where it is not stable.</p><div><canvas id="fan" role="img" '
        'aria-label="Every run as a line over all columns"></canvas></div></div>'
        '<div id="limits"></div><button id="all">All runs</button></section>'
        '<h2>Runs</h2><p id="count"></p><div class="scroll"><table id="rows"></table></div>'
    )
