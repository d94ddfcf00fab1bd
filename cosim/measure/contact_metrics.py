"""Metrics of two ports and of contact: errors apart by phase, and energy at the ports.

With x(t) the entries of a signal, its target, and a contact force f_c(t), recorded at t_0 … t_n:

===========  =====================================================================================
rms_free     sqrt(∫ |x - target|² dt / ∫ dt) over the intervals with f_c = 0 at both ends
rms_contact  the same over the intervals with f_c ≠ 0 at either end
energy       min over t of E(t) = ∫ (f_1ᵀ v_1 - f_2ᵀ v_2) dt, J: the passivity observer
===========  =====================================================================================

Integrals are trapezoids over the recorded rows. A phase that never occurs has no number.

Sources: position and force errors by phase as in the comparisons of bilateral controllers (for
example Rodriguez-Seda, Lee, Spong, IEEE T-RO 25(6), 2009); the observer: Hannaford and Ryu, IEEE
T-RA 18(1), 2002. With f_1 the hand's torque on one robot and f_2 the other robot's on its
environment, whatever is passive between the ports never has E below minus what it stored at first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, nan, sqrt
from typing import Literal

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.units import time_text
from cosim.measure.energy import net_power
from cosim.measure.metric_result import MetricResult, length
from cosim.record.piecewise import NotFinite, PairwiseSum, RunningIntegral, Stacked, pieces
from cosim.record.signals import Array, Signals, stack

Phase = Literal["rms_free", "rms_contact"]


@dataclass(frozen=True, slots=True)
class PhaseError:
    """The distance of a signal from its target in one phase; `kind` as in the table above.

    `target`: a number per entry, or a signal; `contact`: signals that are 0 in free motion.
    """

    name: str
    kind: Phase
    of: tuple[str, ...]
    target: tuple[float, ...] | str
    contact: tuple[str, ...]
    label: str = ""

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals it reads."""
        target = (self.target,) if isinstance(self.target, str) else ()
        return (*self.of, *target, *self.contact)

    def evaluate(self, signals: Signals) -> MetricResult:
        """The root mean square over the phase; how long it lasts in the parts (`lasts_s`)."""
        place, label = f"metrics.{self.name}", self.label or self.name
        unit = Stacked(signals, self.of, place).unit
        try:
            count = sum(len(dt) for dt, _ in self._intervals(signals, place))
            times, sums = PairwiseSum(count), PairwiseSum(count)
            for dt, square in self._intervals(signals, place):
                times.add(dt)
                sums.add(square * dt)
        except NotFinite as why:
            return MetricResult(self.name, label, nan, unit, str(why))
        lasts = times.value
        if lasts <= 0:
            return MetricResult(self.name, label, nan, unit, "the phase never occurs")
        mean = sums.value / lasts
        return MetricResult(
            self.name, label, sqrt(mean), unit, f"RMS over {time_text(lasts)}", {"lasts_s": lasts}
        )

    def _intervals(self, signals: Signals, place: str) -> Iterator[tuple[Array, Array]]:
        """The lengths, s, of intervals of the phase, and the mean square in each, in pieces.

        Raises NotFinite.
        """
        t = square = touches = np.empty(0)
        for piece in pieces(signals, self.signals):
            x, touched = stack(piece, self.of, place), stack(piece, self.contact, place)
            if flaw := x.problem or touched.problem:
                raise NotFinite(flaw)
            new = length(x.x - self._target(piece, x.x.shape[1], place)) ** 2
            t, square = np.concatenate((t, x.t)), np.concatenate((square, new))
            touches = np.concatenate((touches, (touched.x != 0.0).any(axis=1)))
            within = (touches[1:] != 0) | (touches[:-1] != 0)
            if self.kind == "rms_free":
                within = ~within
            yield np.diff(t)[within], 0.5 * (square[1:] + square[:-1])[within]
            t, square, touches = t[-1:], square[-1:], touches[-1:]

    def _target(self, signals: Signals, size: int, place: str) -> Array:
        """(n, m) or (1, m), m = `size`."""
        if isinstance(self.target, str):
            target = stack(signals, (*self.of, self.target), place).x[:, size:]
        else:
            target = np.array([self.target], dtype=np.float64)
        if target.shape[1] != size:
            raise ScenarioError(
                f"{', '.join(self.of)} has size {size}, its target {target.shape[1]}", place
            )
        return target


@dataclass(frozen=True, slots=True)
class PortEnergy:
    """min E(t) of the two ports `of` = (f_1, v_1, f_2, v_2), or of one, J.

    Parts: E at the end (`final`), what the force at the first port put in while its power was
    positive (`put_in`), and min E as a share of that (`least_share`).
    """

    name: str
    of: tuple[str, ...]
    label: str = ""

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals it reads."""
        return self.of

    def evaluate(self, signals: Signals) -> MetricResult:
        """The least value of the observer, which starts at 0.

        Raises ScenarioError where `of` does not name ports.
        """
        place, label = f"metrics.{self.name}", self.label or self.name
        if len(self.of) not in (2, 4):
            raise ScenarioError(
                f"'of' names {len(self.of)} signals; expected force and velocity of one port or of"
                " two",
                place,
            )
        units = [Stacked(signals, (name,), place) for name in self.of]
        try:
            least, at, final, put_in = self._energies(signals, place)
        except NotFinite as why:
            return MetricResult(self.name, label, nan, "J", str(why))
        parts = {"final": final, "put_in": put_in}
        if put_in > 0:
            parts["least_share"] = least / put_in
        more = ((f"{label}, end", f"{final:.4g} J at {time_text(units[0].last)}"),)
        return MetricResult(self.name, label, least, "J", f"at {time_text(at)}", parts, more)

    def _energies(self, signals: Signals, place: str) -> tuple[float, float, float, float]:
        """The least energy, its time, s, the last one, and what was put in, J. Raises NotFinite."""
        least, at, final, put_in = inf, nan, RunningIntegral(), RunningIntegral()
        for piece in pieces(signals, self.of):
            each = [stack(piece, (name,), place) for name in self.of]
            if flaw := next((s.problem for s in each if s.problem), ""):
                raise NotFinite(flaw)
            ends = [(each[i].x, each[i + 1].x) for i in range(0, len(each), 2)]
            for force, rate in ends:
                if force.shape != rate.shape:
                    raise ScenarioError("a force and its velocity differ in size", place)
            E = final.add(net_power(ends), each[0].t)
            put_in.add(np.maximum(net_power(ends[:1]), 0.0), each[0].t)
            if E.min() < least:
                least, at = float(E.min()), float(each[0].t[int(np.argmin(E))])
        return least, at, final.value, put_in.value
