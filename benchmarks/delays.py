"""What a time-varying delay on every connection costs: links against wires."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import Case, Document, delayed, vdp_ring, wide_ring
from benchmarks.ours import Ours
from benchmarks.race import Contestant, Session, race
from cosim.base.copies import replace
from cosim.links.semantics import Grid
from cosim.links.table import TableSpec, TableStream
from cosim.schedule.plan import Plan


@final
class _Ready:
    """Rows that are there already, once around and again."""

    def __init__(self, rows: NDArray[np.int32]) -> None:
        self._rows, self._at = rows, 0

    def take(self, n: int) -> NDArray[np.int32]:
        self._at += n
        return self._rows[self._at - n : self._at]


@dataclass(frozen=True, slots=True)
class Prepared:
    """A link's table drawn before the run: leaves what the engine itself does with it."""

    table: TableSpec
    rows: NDArray[np.int32]

    @property
    def name(self) -> str:
        """The link's name."""
        return self.table.name

    @property
    def grid(self) -> Grid:
        """Periods of sender and receiver, and the base step."""
        return self.table.grid

    @property
    def history(self) -> int:
        """Samples to keep."""
        return self.table.history

    @property
    def minimum_delay_ticks(self) -> int:
        """Least age of a sample at a look, ticks."""
        return self.table.minimum_delay_ticks

    def check(self, length: int) -> None:
        """As the table does."""
        self.table.check(length)

    def stream(self, length: int | None = None) -> TableStream:
        """The rows, from memory."""
        return TableStream(_Ready(self.rows), length)

    def facts(self) -> dict[str, Any]:
        """As the table does."""
        return self.table.facts()


def prepared(plan: Plan) -> Plan:
    """The plan with all its tables drawn."""
    links = []
    for link in plan.links:
        rows = link.table.stream(plan.ticks).rows(plan.ticks)
        links.append(replace(link, table=Prepared(link.table, rows)))
    return replace(plan, links=tuple(links))


def delays(ticks: int, blocks: int, rounds: int, check: int) -> list[dict[str, Any]]:
    """Rings with wires and with links; ns a scalar and tick that the links add."""
    results = []
    for name, document, port, source, n, width in (
        ("ring12", partial(vdp_ring, 12), "u", "x", 12, 1),
        ("wide4", wide_ring, "u", "y", 4, 14),
    ):
        plain = Case(name, name, document, n, ticks)
        kinds = [("one link a connection", 0)]
        if width > 1:
            kinds.append(("one link a scalar", width))
        for title, scalars in kinds:
            build = partial(_late, document, port, source, scalars)
            late = Case(f"{name}-late", title, build, n, ticks)
            rows = _race(plain, late, ticks, blocks, rounds, check)
            results.append(_facts(name, title, n * width, n, rows))
    return results


def _late(document: Callable[[], Document], port: str, source: str, scalars: int) -> Document:
    return delayed(document(), port, source, scalars)


def _ours(case: Case, ticks: int) -> Session:
    return Ours(case.plan("fmi2", ticks))


def _drawn(case: Case, ticks: int) -> Session:
    return Ours(prepared(case.plan("fmi2", ticks)))


def _race(
    plain: Case, late: Case, ticks: int, blocks: int, rounds: int, check: int
) -> dict[str, dict[str, Any]]:
    total = check + ticks * blocks * rounds
    makers = {
        "links, drawn before": partial(_drawn, late, total),
        "links, drawn in the run": partial(_ours, late, total),
        "wires": partial(_ours, plain, total),
    }
    contestants = [Contestant(label, make, "wires", 1.0, blocks) for label, make in makers.items()]
    timings = race(contestants, ticks=ticks, fmu_steps=plain.fmu_steps, rounds=rounds, check=check)
    return {t.label: t.facts() for t in timings}


def _facts(
    case: str, title: str, scalars: int, n: int, rows: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """Per scalar and tick: (link's µs a FMU step - wire's) * FMU steps / scalars."""
    wires = rows["wires"]["min_us"]
    added = {
        label: (row["min_us"] - wires) * n / scalars * 1e3
        for label, row in rows.items()
        if label != "wires"
    }
    return {"case": case, "links": title, "scalars": scalars, "rows": rows, "added_ns": added}
