"""Impairment of the packets of one directed link: delay, loss, order, rate, partition.

Delays are drawn as a function of time, every `GRID`; losses are drawn per packet, as on a link of a
scenario whose sender sends at that rate. Time is an argument.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite
from pathlib import Path
from typing import Any, final

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.random_numbers import generator
from cosim.links.losses import Lossy
from cosim.links.spec import delay_law, loss_model

GRID = Fraction(1, 1000)
_CHUNK = 1024
_KEYS = ("delay", "loss", "ordered", "rate", "down")


@dataclass(frozen=True, slots=True)
class RelayLinkSpec:
    """One direction. `delay`, `loss`: as ``[[links]]`` of a scenario have them; None: none.

    `ordered`: a packet never overtakes; `rate`: bit/s, 0: no limit; `down`: nothing goes through.
    """

    delay: Mapping[str, Any] | None = None
    loss: Mapping[str, Any] | None = None
    ordered: bool = True
    rate: float = 0.0
    down: bool = False

    @classmethod
    def of(cls, given: Mapping[str, Any], place: str) -> RelayLinkSpec:
        """The specification in a table. Raises ScenarioError for unknown keys."""
        for key in given:
            if key not in _KEYS:
                raise ScenarioError(
                    f"unknown key {key!r}; expected one of {', '.join(_KEYS)}", place
                )
        return cls(**given)


@final
class Impairment:
    """Decides when each packet of a link `name` leaves, t = 0 being `start_ns`."""

    def __init__(self, name: str, spec: RelayLinkSpec, seed: int, start_ns: int = 0) -> None:
        self.name, self.seed, self._start = name, seed, start_ns
        self._free = self._last = 0
        self.set(spec)

    def set(self, spec: RelayLinkSpec) -> None:
        """Other laws from now on, drawn from their beginning.

        Raises ScenarioError where `spec` names no laws, or losses twice.
        """
        self.spec = spec
        self._delays = self._losses = None
        law = None if spec.delay is None else delay_law(spec.delay, Path())
        model = None if spec.loss is None else loss_model(spec.loss)
        if isinstance(law, Lossy):  # a preset of a network
            if model is not None:
                raise ScenarioError("the preset already defines losses; expected no key loss")
            model = law.loss
            law = law.delay
        if law is not None:
            self._delays = law.stream(GRID, generator(self.seed, f"{self.name} delay"))
        if model is not None:
            self._losses = model.stream(GRID, generator(self.seed, f"{self.name} loss"))
        self._drawn = np.empty(0)
        self._lost = np.empty(0, dtype=bool)
        self._packets = 0

    def schedule_packet(self, t_ns: int, length: int) -> tuple[int, int]:
        """(delay, time of leaving) of a packet of `length` bytes at `t_ns`, ns; -1: lost."""
        if self._is_lost() or self.spec.down:
            return -1, -1
        delay = self._delay(t_ns)
        if delay < 0:
            return -1, -1
        leaves = max(t_ns, self._free)
        if self.spec.rate > 0:
            leaves += round(8e9 * length / self.spec.rate)
            self._free = leaves
        leaves += delay
        if self.spec.ordered:
            leaves = max(leaves, self._last)
        self._last = max(leaves, self._last)
        return delay, leaves

    def _delay(self, t_ns: int) -> int:
        """The delay at `t_ns`, ns; -1 where a trace lost the packet."""
        if self._delays is None:
            return 0
        k = max(0, t_ns - self._start) // round(1e9 * GRID)
        while k >= len(self._drawn):
            self._drawn = np.append(self._drawn, self._delays.take(_CHUNK))
        drawn = float(self._drawn[k])
        return round(1e9 * drawn) if isfinite(drawn) else -1

    def _is_lost(self) -> bool:
        if self._losses is None:
            return False
        k = self._packets
        self._packets += 1
        while k >= len(self._lost):
            self._lost = np.append(self._lost, self._losses.take(_CHUNK))
        return bool(self._lost[k])
