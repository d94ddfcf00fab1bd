"""A page that shows a running rehearsal: the diagrams and arms of a report, and what is new."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from math import ceil, isfinite
from pathlib import Path
from typing import Any, final

import numpy as np

from bridge.monitor.figure import panels
from bridge.monitor.journal_signals import JournalSignals
from bridge.monitor.snapshot import snapshot
from bridge.monitor.view import view
from bridge.recording.live_run import LiveRun
from cosim.base.units import printed_unit
from cosim.reporting.arms import DrawnArm, drawing_of, in_workspaces
from cosim.reporting.html import Badge, PageData, PlottedPanel, page_text
from cosim.scenario.spec import as_data

#: s between two values that are sent, s of the run that a new page gets, and what it shows.
STEP, BACKLOG = 0.02, 30.0
#: Where values come from, below the address of the page.
EVENTS = "events"


@final
class LivePage:
    """The page of a run that may still be running; it reads files only."""

    def __init__(self, watched: LiveRun) -> None:
        self._watched = watched
        system = watched.system
        known = JournalSignals(system, {})
        self._data = PageData(system.plan.ticks * system.plan.h, live=EVENTS)
        for panel in panels(watched):
            labels = panel.labels or panel.y
            entries = [(known.entries(y), label) for y, label in zip(panel.y, labels, strict=True)]
            series = tuple(_series(entries))
            unit = known.unit(series[0][0])
            title = f"{panel.title or ', '.join(panel.y)}"
            self._data.panels.append(PlottedPanel(title, unit, series))
        self._data.arms += list(self._arms(known))
        drawn = [name for panel in self._data.panels for name, _ in panel.series]
        joints = chain.from_iterable(arm["q"] for arm in self._data.arms)
        self._names = tuple(dict.fromkeys([*drawn, *joints]))
        for name in self._names:
            unit = known.unit(name)
            self._data.signals[name] = {"label": name, "unit": printed_unit(unit), "t": "", "y": ""}

    def _arms(self, known: JournalSignals) -> Iterator[dict[str, Any]]:
        scenario = self._watched.system.scenario
        folder, found = Path(scenario.path).parent, []
        for name, spec in scenario.components.items():
            options = dict(spec.options or {})
            drawing = drawing_of(str(spec.model), options, folder)
            if drawing is not None:
                found.append(DrawnArm(name, drawing, options, folder))
        links = {f"{link.source}->{link.target}": None for link in scenario.links}
        for arm in in_workspaces(found, {"scenario": as_data(scenario), "links": links}):
            q = known.entries(f"{arm.name}.{arm.drawing.position}")
            yield {**arm.data(), "q": list(q), "torque": []}

    def text(self) -> str:
        """The page. Raises CosimError where uPlot is not installed."""
        title, folder = self._watched.system.scenario.title, self._watched.folder.name
        badge = Badge("running", "what the nodes write; nothing is sent to them")
        status = '<section id="status" aria-live="off"></section>'
        return page_text(title, folder, badge, "", self._data, status)

    def news(self, now_ns: int, after: float | None = None) -> dict[str, Any]:
        """The values a page needs now. `now_ns`: monotonic; `after`: the newest time it has, s.

        None: it has nothing, and gets the last BACKLOG s. Numbers that are not finite are None.
        """
        found = snapshot(self._watched, now_ns)
        said = view(found)
        t, signals = self._values(found.t, after)
        return {
            "t": t,
            "signals": signals,
            "now": found.t,
            "ended": not found.running,
            "head": said.head,
            "tables": [
                {"title": x.title, "head": x.head, "rows": x.rows, "marked": sorted(x.marked)}
                for x in said.tables
            ],
        }

    def _values(
        self, now: float, after: float | None
    ) -> tuple[list[float], dict[str, list[float | None]]]:
        """Times and values after a time, one for each STEP."""
        span = BACKLOG if after is None else min(BACKLOG, now - after)
        h = self._watched.system.plan.h
        if span < h / 2:
            return [], {}
        rows = self._watched.recent(span + STEP)
        held = JournalSignals(self._watched.system, rows, span, gaps=False)
        ticks = np.round(held.t / h).astype(np.int64)
        chosen = np.flatnonzero(ticks % max(1, ceil(STEP / h - 1e-9)) == 0)
        if after is not None:
            chosen = chosen[held.t[chosen] > after + h / 2]
        signals = {n: _finite(held.array(n)[chosen, 0].tolist()) for n in self._names}
        return np.round(held.t[chosen], 9).tolist(), signals


def _series(entries: Sequence[tuple[tuple[str, ...], str]]) -> Iterator[tuple[str, str]]:
    """(name, label) of every entry of the signals of a panel."""
    for names, label in entries:
        for name in names:
            suffix = name[name.rfind("[") :] if len(names) > 1 else ""
            yield name, f"{label}{suffix}"


def _finite(values: Sequence[float]) -> list[float | None]:
    return [value if isfinite(value) else None for value in values]
