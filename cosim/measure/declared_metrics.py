"""The metrics a scenario declares, and signals that refuse one without meaning in time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.names import signal_of, unknown
from cosim.measure.metrics import Metric, metric
from cosim.record.signals import Array, only_unit
from cosim.scenario.spec import Scenario


def metrics(scenario: Scenario) -> list[Metric]:
    """The scenario's metrics, durations in s. Raises ScenarioError with the place of an error."""
    found = []
    for name, spec in scenario.metrics.items():
        window = spec.window
        seconds = None if window is None else scenario.seconds(window, "metrics", name, "window")
        found.append(
            metric(
                name,
                spec.kind,
                spec.of,
                target=spec.target,
                within=spec.within,
                window=seconds,
                contact=spec.contact,
                norm=spec.norm,
                label=spec.label,
                place=scenario.place("metrics", name),
            )
        )
    return found


@final
class Preview:
    """Signals of one row, all 0, with the names and units of what will be recorded.

    `units`: of each scalar by its name, ``master.q[0]``.
    """

    def __init__(self, units: Mapping[str, str]) -> None:
        self._units = units
        self._whole: dict[str, list[str]] = {}
        for name in units:
            self._whole.setdefault(signal_of(name), []).append(name)

    @property
    def t(self) -> Array:
        """The only row, (1,), s."""
        return np.zeros(1)

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of a signal's entries. Raises ScenarioError for one that is not recorded."""
        if prefix in self._units:
            return (prefix,)
        if prefix not in self._whole:
            raise ScenarioError(unknown(prefix, sorted(self._whole), "recorded signal"))
        return tuple(self._whole[prefix])

    def array(self, prefix: str) -> Array:
        """Zeros for each entry, (1, m)."""
        return np.zeros((1, len(self.entries(prefix))))

    def unit(self, prefix: str) -> str:
        """Unit of a signal. Raises ScenarioError if its entries differ in it."""
        return only_unit({name: self._units[name] for name in self.entries(prefix)})
