"""A snapshot of a rehearsal in words: tables for a terminal, one line for everything else."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isnan

from bridge.monitor.snapshot import NodeView, Snapshot
from cosim.measure.metrics import MetricResult


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of texts; `marked`: rows that want attention."""

    title: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    marked: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class View:
    """One state of the display: `head` and `tables` on a terminal, or everything in one `line`."""

    head: str
    line: str
    tables: Sequence[TextTable]

    @property
    def attention(self) -> str:
        """The first cells of all marked rows, by table; "": no row is marked."""
        found = {t.title: [t.rows[i][0] for i in sorted(t.marked)] for t in self.tables}
        return "; ".join(f"{title}: {', '.join(rows)}" for title, rows in found.items() if rows)

    def lines(self, width: int = 0) -> Iterator[tuple[str, bool]]:
        """Lines of text, and whether they want attention.

        `width`: columns at which they are folded, so that none of them is cut; 0: not folded.
        """
        for text, marked in self._lines():
            if width and len(text) > width:
                yield from ((part, marked) for part in _folded(text, width))
            else:
                yield text, marked

    def _lines(self) -> Iterator[tuple[str, bool]]:
        yield self.head, False
        if self.attention:
            yield f"look at  {self.attention}", True
        for table in self.tables:
            yield "", False
            yield from aligned(table)


def _folded(text: str, width: int) -> list[str]:
    """A line in parts of at most `width` columns; the further ones are indented."""
    return textwrap.wrap(
        text, width, subsequent_indent="      ", break_on_hyphens=False, drop_whitespace=True
    )


def view(s: Snapshot) -> View:
    """A snapshot to be shown."""
    head = f"{s.run}: t = {s.t:.2f} of {s.length:g} s; {'runs' if s.running else 'has ended'}"
    return View(head, line(s), tables(s))


def tables(s: Snapshot) -> list[TextTable]:
    """A snapshot as tables; empty ones are left out."""
    nodes = [_node_row(n) for n in s.nodes]
    bad = frozenset(
        i
        for i, n in enumerate(s.nodes)
        if n.state not in ("active", "finished") or n.missed or n.quiet > 0.5
    )
    lost = frozenset(i for i, x in enumerate(s.inlets) if x.lost)
    found = [
        TextTable(
            "nodes",
            ("node", "state", "slot", "late p50", "p99", "max us", "missed", "notes"),
            nodes,
            bad,
        ),
        TextTable(
            "inputs from other nodes",
            ("from", "to", "network ms", "max", "age ms", "max", "lost"),
            [
                (x.source, x.target, *map(_ms, (*x.network, *x.age)), f"{x.lost} of {x.sent}")
                for x in s.inlets
            ],
            lost,
        ),
        TextTable(
            "buses",
            ("bus", "frames/s", "load"),
            [(b.name, str(b.frames), "" if isnan(b.load) else f"{b.load:.1%}") for b in s.buses],
        ),
        TextTable("metrics", ("metric", "now"), [(r.label, result(r)) for r in s.metrics]),
        TextTable(
            "outputs",
            ("signal", "unit", "values"),
            [(x.name, x.unit, values(x.values)) for x in s.signals],
        ),
        TextTable("not readable", ("file", "why"), list(s.unreadable.items())),
    ]
    return [table for table in found if table.rows]


def aligned(table: TextTable) -> Iterator[tuple[str, bool]]:
    """Lines of a table with columns that line up, numbers to the right; whether one is marked."""
    every = [table.head, *table.rows]
    widths = [max(len(row[i]) for row in every) for i in range(len(table.head))]
    right = [
        all(not row[i] or row[i][0] in "-0123456789" for row in table.rows)
        for i in range(len(table.head))
    ]
    yield table.title, False
    for n, row in enumerate(every):
        cells = [
            text.rjust(w) if r else text.ljust(w)
            for text, w, r in zip(row, widths, right, strict=True)
        ]
        yield f"  {'  '.join(cells)}".rstrip(), n > 0 and n - 1 in table.marked


def _node_row(n: NodeView) -> tuple[str, ...]:
    late = ["", "", ""]
    if n.late is not None:
        late = [f"{v * 1e-3:.0f}" for v in (n.late.p50, n.late.p99, n.late.maximum)]
    notes = [n.reasons, f"now: {n.now}" if n.now else ""]
    notes += [f"guard: {n.guarded}" if n.guarded else ""]
    notes += [f"{n.injected} faults injected" if n.injected else ""]
    notes += [f"silent for {n.quiet:.1f} s" if n.quiet > 0.5 else ""]
    slot = str(n.slot) if n.slot >= 0 else ""
    return (str(n.life), n.state, slot, *late, str(n.missed), "; ".join(filter(None, notes)))


def _ms(value: float) -> str:
    return "never" if isnan(value) else f"{value:.2f}"


def result(r: MetricResult) -> str:
    """A number with its unit, or why there is none."""
    if isnan(r.value):
        return f"no number: {r.detail}"
    return f"{r.value:.4g}" + ("" if r.unit == "1" else f" {r.unit}")


def values(found: Sequence[float], most: int = 8) -> str:
    """Up to `most` numbers in columns, with no unit; their count follows if not all are shown."""
    text = "  ".join(f"{v:9.4g}" for v in found[:most])
    return text + (f"  … {len(found)}" if len(found) > most else "")


def line(s: Snapshot) -> str:
    """A snapshot in one line, for output that is not a terminal."""
    nodes = [f"{n.life} {n.state}" + (f" ({n.missed} missed)" if n.missed else "") for n in s.nodes]
    late = [f"{n.late.p99 * 1e-3:.0f}" for n in s.nodes if n.late is not None]
    parts = [f"t = {s.t:.2f} of {s.length:g} s", ", ".join(nodes)]
    parts += [f"late p99 {'/'.join(late)} us"] if late else []
    parts += [f"{r.label} {result(r)}" for r in s.metrics if not isnan(r.value)]
    parts += [f"{b.name} {b.load:.1%}" for b in s.buses if not isnan(b.load)]
    return "; ".join(parts)
