"""Values of messages in the last second, on one time axis, for metrics."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.system import System
from bridge.monitor.messages import SPAN_NS, ReceivedMessage
from cosim.base.errors import ScenarioError
from cosim.base.names import signal_of
from cosim.measure import declared_metrics
from cosim.measure.metrics import Error, Metric, MetricResult

Array = NDArray[np.float64]
#: s between two rows.
STEP = 0.005


@final
class Recent:
    """Signals like :class:`cosim.record.signals.Signals`: a value holds until the next one.

    Before its first one holds too; of what has not come for a second all is NaN. `t` ends at 0,
    which is `now_ns` (monotonic).
    """

    def __init__(self, system: System, heard: Iterable[ReceivedMessage], now_ns: int) -> None:
        slots = [s for n in system.nodes.values() for x in n.plan.components for s in x.outputs]
        self._slots = {slot.name: slot for slot in slots}
        self._places: dict[str, tuple[ReceivedMessage, int]] = {}
        for message in heard:
            carried = [name for part in message.carried.outlet.parts for name in part.scalars()]
            self._places |= {name: (message, i) for i, name in enumerate(carried)}
        self._now_ns = now_ns

    @property
    def t(self) -> Array:
        """(n,), s."""
        return np.arange(-SPAN_NS * 1e-9 + STEP, STEP / 2, STEP)

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m)."""
        return np.stack([self._column(name) for name in self.entries(prefix)], axis=1)

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of the entries of a signal, (m,). Raises ScenarioError if no message has it."""
        if not self.has(prefix):
            raise ScenarioError(f"{prefix} is not sent on any monitored bus")
        return self._scalars(prefix)

    def has(self, prefix: str) -> bool:
        """True if messages carry all of a signal."""
        return all(name in self._places for name in self._scalars(prefix))

    def _scalars(self, prefix: str) -> tuple[str, ...]:
        return self._slots[prefix].scalars() if prefix in self._slots else (prefix,)

    def unit(self, prefix: str) -> str:
        """Unit of a signal, or of an entry."""
        if prefix in self._slots:
            return self._slots[prefix].unit
        slot = self._slots[signal_of(prefix)]
        return slot.unit_of(slot.scalars().index(prefix))

    def _column(self, name: str) -> Array:
        message, place = self._places[name]
        if not message.recent:
            return np.full(len(self.t), np.nan)
        times = np.array([s.t_ns - self._now_ns for s in message.recent]) * 1e-9
        values = np.array([s.values[place] for s in message.recent])
        row = np.searchsorted(times, self.t, side="right") - 1
        return np.asarray(values[np.maximum(row, 0)], dtype=np.float64)


def metrics(
    system: System, heard: Iterable[ReceivedMessage], now_ns: int
) -> tuple[list[MetricResult], tuple[str, ...]]:
    """The scenario's metrics over the last second, and the signals that the others lack."""
    recent = Recent(system, heard, now_ns)
    found, missing = [], []
    for metric in declared_metrics.metrics(system.scenario):
        absent = [name for name in _metric_signals(metric) if not recent.has(name)]
        missing += absent
        if not absent:
            found.append(metric.evaluate(recent))
    return found, tuple(dict.fromkeys(missing))


def _metric_signals(metric: Metric) -> list[str]:
    target = metric.target if isinstance(metric, Error) else None
    return [*metric.of, *([target] if isinstance(target, str) else [])]
