"""Signals of nodes on one time axis, for metrics and figures of an active run.

As in a run folder, what a node computed in a slot holds until its next one. Besides the signals
there are ``lateness of NODE`` and ``age of COMPONENT.PORT`` (of what was held) and
``network's part of …`` (of what came last), in ms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.cut import NodePlan
from bridge.deployment.system import System
from cosim.base.errors import ScenarioError

Array = NDArray[np.float64]
Rows = NDArray[np.void]
_LATE, _AGE, _NETWORK = "lateness of ", "age of ", "network's part of "


@final
class JournalSignals:
    """Rows of nodes, as :class:`cosim.record.signals.Signals`; a node without rows is NaN.

    `rows`: by node, ascending slots; `span`: s before the newest slot of all nodes; None:
    everything. `gaps`: a node that executes no slots is NaN, too, instead of its last values.
    """

    def __init__(
        self,
        system: System,
        rows: Mapping[str, Rows],
        span: float | None = None,
        *,
        gaps: bool = False,
    ) -> None:
        self._system, self._rows, self._gaps = system, rows, gaps
        self._entries: dict[str, tuple[str, ...]] = {}
        self._units: dict[str, str] = {}
        self._places: dict[str, tuple[str, int]] = {}
        for name, node in system.nodes.items():
            self._declare(name, node)
        h = system.plan.h
        last = [int(r["slot"][-1]) * system.nodes[n].ticks for n, r in rows.items() if len(r)]
        first = [int(r["slot"][0]) * system.nodes[n].ticks for n, r in rows.items() if len(r)]
        end = max(last, default=-1)
        begin = min(first, default=0)
        if span is not None:
            begin = max(begin, end + 1 - round(span / h))
        self._ticks = np.arange(begin, end + 1, dtype=np.int64)
        self._index: dict[str, NDArray[np.int64]] = {}

    def _declare(self, name: str, node: NodePlan) -> None:
        owned = {slot.name: slot for step in node.plan.components for slot in step.outputs}
        heard = {slot.name: slot for step in node.plan.components for slot in step.inputs}
        for slot in {**heard, **owned}.values():
            self._entries[slot.name] = slot.scalars()
            self._units[slot.name] = slot.unit
            for i, scalar in enumerate(slot.scalars()):
                self._places[scalar] = (name, slot.start + i)
                self._units[scalar] = slot.unit_of(i)
        self._extra(f"{_LATE}{name}", name, 0)
        for i, inlet in enumerate(node.inlets):
            self._extra(f"{_AGE}{inlet.target.name}", name, i)
            self._extra(f"{_NETWORK}{inlet.target.name}", name, i)

    def _extra(self, label: str, node: str, index: int) -> None:
        self._entries[label], self._units[label] = (label,), "ms"
        self._places[label] = (node, index)

    @property
    def t(self) -> Array:
        """Time of each base tick, (n,), s."""
        return np.asarray(self._ticks * self._system.plan.h, dtype=np.float64)

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""
        return np.stack([self._column(name) for name in self.entries(prefix)], axis=1)

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of the entries of a signal, (m,). Raises ScenarioError for an unknown signal."""
        if prefix in self._entries:
            return self._entries[prefix]
        if prefix in self._places:
            return (prefix,)
        raise ScenarioError(f"no node has a signal {prefix!r}")

    def unit(self, prefix: str) -> str:
        """Unit of a signal."""
        self.entries(prefix)
        return self._units[prefix]

    def _column(self, name: str) -> Array:
        node, index = self._places[name]
        rows = self._rows.get(node)
        if rows is None or not len(rows):
            return np.full(len(self._ticks), np.nan)
        values = self._values(name, rows, index)
        if node not in self._index:
            self._index[node] = self._held(rows, self._system.nodes[node].ticks)
        row = self._index[node]
        return np.where(row < 0, np.nan, values[np.maximum(row, 0)])

    def _held(self, rows: Rows, ticks: int) -> NDArray[np.int64]:
        """The row that holds at each tick, (n,), -1: none; `ticks`: of a slot."""
        at = rows["slot"] * ticks
        found = np.searchsorted(at, self._ticks, side="right") - 1
        if self._gaps:
            found[self._ticks - at[np.maximum(found, 0)] >= ticks] = -1
        return np.asarray(found, dtype=np.int64)

    def _values(self, name: str, rows: Rows, index: int) -> Array:
        if name.startswith(_LATE):
            return np.asarray((rows["woke_ns"] - rows["deadline_ns"]) * 1e-6)
        if name.startswith((_AGE, _NETWORK)):
            inlet = rows["inlets"][:, index]
            ns = inlet["age_ns" if name.startswith(_AGE) else "transit_ns"]
            return np.where(inlet["held"] < 0, np.nan, ns * 1e-6)
        return np.asarray(rows["signals"][:, index], dtype=np.float64)


def lateness_names(nodes: Sequence[str]) -> tuple[str, ...]:
    """Names of the lateness of nodes, ms."""
    return tuple(f"{_LATE}{n}" for n in nodes)


def ages(targets: Sequence[str], *, network: bool = False) -> tuple[str, ...]:
    """Names of the ages of inputs, ms; or of the network's part of them."""
    return tuple(f"{_NETWORK if network else _AGE}{t}" for t in targets)
