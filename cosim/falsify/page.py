"""``report.html`` of a failure: nominal and failing run beside each other, segments marked."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from cosim.falsify import words
from cosim.falsify.execute import Falsification
from cosim.links.laws import decimal_fraction
from cosim.measure.link_ages import link_ages
from cosim.record import Run
from cosim.record.signals import Array
from cosim.reporting.html import (
    Badge,
    PageData,
    PlottedPanel,
    TimedEvent,
    cards,
    command,
    folded,
    table,
    write_page,
)

PAGE = "report.html"
#: Points of a signal, entries and links that are drawn.
POINTS, ENTRIES, LINKS = 2400, 8, 6
#: Values so far outside of those of the nominal run are left out, in sizes of its range.
FAR = 4.0


def write_comparison(
    state: Falsification, failing: Run, nominal: Run, folder: Path, repeat: str
) -> Path:
    """Write the page. Raises CosimError if it cannot be written."""
    assert state.found is not None and state.shrinking is not None
    data = PageData(float(nominal.t[-1]))
    for name in _signals(state, nominal):
        _add_signal(data, name, failing, nominal)
    _add_links(state, data, failing, nominal)
    data.events += list(_events(state))
    numbers = [(k, v) for k, v in words.lines(state) if k not in ("breaks",)]
    head = ["link", "delay", "from", "to"]
    trial, h = state.shrinking.now, decimal_fraction(state.problem.h)
    rows = [
        (state.problem.channels[i].name, words.delay_of(state, i, p),
         f"{float(p.begin * h):g} s", f"{float(p.end * h):g} s")
        for i, p in trial.pieces
    ]  # fmt: skip
    scenario = folder / "failing.toml"
    rest = "".join([
        f"<h2>The network</h2>{table(head, rows, 3)}" if rows else "",
        f"<h2>Repeat it</h2>{command('run', f'cosim run {os.path.relpath(scenario)}')}",
        '<p>Both runs: <a href="failing/report.html">failing</a>, '
        '<a href="nominal/report.html">nominal</a>.</p>',
        folded("The search", _search(state) + command("repeat", repeat)),
    ])  # fmt: skip
    title = f"The network that breaks {state.found.requirement}"
    return write_page(
        folder / PAGE, title, str(state.problem.path),
        Badge("failed", f"{words.sentence(state)}."), cards(numbers), data, rest,
    )  # fmt: skip


def _signals(state: Falsification, run: Run) -> Iterator[str]:
    names = [e for s in state.problem.signals for e in run.entries(s)]
    yield from dict.fromkeys(names[:ENTRIES])


def _add_signal(data: PageData, name: str, failing: Run, nominal: Run) -> None:
    """A diagram of a scalar in both runs."""
    usual = nominal.column(name)
    low, high = float(np.nanmin(usual)), float(np.nanmax(usual))
    room = FAR * max(high - low, 1e-9)
    unit = nominal.units[name]
    both = []
    for label, run in (("nominal", nominal), ("failing", failing)):
        values = run.column(name)
        near = (values >= low - room) & (values <= high + room)
        _add(data, f"{label} {name}", unit, run.t, np.where(near, values, np.nan))
        both.append((f"{label} {name}", label))
    data.panels.append(PlottedPanel(name, unit, tuple(both)))


def _add(data: PageData, name: str, unit: str, t: Array, values: Array) -> None:
    dt = float(t[-1] - t[0]) / max(1, len(t) - 1)
    data.add(name, unit, values, dt, POINTS)


def _add_links(state: Falsification, data: PageData, failing: Run, nominal: Run) -> None:
    """A diagram of the ages on each link that differs, or on the first ones."""
    assert state.shrinking is not None
    changed = state.shrinking.now.channels
    channels = [c for i, c in enumerate(state.problem.channels) if i in changed or not changed]
    links = [state.problem.links[i] for c in channels for i in c.places][:LINKS]
    for name in links:
        both = []
        for label, run in (("nominal", nominal), ("failing", failing)):
            ages = link_ages(run.link_tables[name])
            data.add(f"{label} age of {name}", "s", ages.age, ages.period, POINTS)
            both.append((f"{label} age of {name}", label))
        data.panels.append(PlottedPanel(f"Age of what {name} holds", "s", tuple(both)))


def _events(state: Falsification) -> Iterator[TimedEvent]:
    assert state.shrinking is not None
    h = decimal_fraction(state.problem.h)
    for i, piece in state.shrinking.now.pieces:
        channel, value = state.problem.channels[i], words.delay_of(state, i, piece)
        label = value if channel.signal else f"sent: {value}"
        if len(state.shrinking.now.channels) > 1:
            label += f" on {channel.name}"
        yield TimedEvent(float(piece.begin * h), label, float(piece.end * h))


def _search(state: Falsification) -> str:
    rows: Sequence[tuple[str, str]] = [(name, str(n)) for name, n in state.account.runs.items()]
    least = "".join(
        f"<p>{escape(name)}: {escape(f'{m.value:.4g} {m.unit}')}, {escape(family)}: "
        f"{escape(candidate.says)}</p>"
        for name, (m, family, candidate) in state.account.least.items()
    )
    return table(["family", "runs"], rows, 1) + f"<p>Least margins of runs to the end:</p>{least}"
