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

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, sqrt
from typing import Literal

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.base.units import time_text
from cosim.measure.energy import observer
from cosim.measure.manipulability import running_integral
from cosim.measure.metric_result import MetricResult, length
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
        x = stack(signals, self.of, place)
        target = self._target(signals, x.x.shape[1], place)
        touched = stack(signals, self.contact, place)
        flaw = x.problem or touched.problem
        if flaw:
            return MetricResult(self.name, label, nan, x.unit, flaw)
        square = length(x.x - target) ** 2
        touches = (touched.x != 0.0).any(axis=1)
        within = touches[1:] | touches[:-1]
        if self.kind == "rms_free":
            within = ~within
        dt = np.diff(x.t)[within]
        lasts = float(dt.sum())
        if lasts <= 0:
            return MetricResult(self.name, label, nan, x.unit, "the phase never occurs")
        mean = float((0.5 * (square[1:] + square[:-1])[within] * dt).sum()) / lasts
        return MetricResult(
            self.name, label, sqrt(mean), x.unit, f"RMS over {time_text(lasts)}", {"lasts_s": lasts}
        )

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
        each = [stack(signals, (name,), place) for name in self.of]
        flaw = next((s.problem for s in each if s.problem), "")
        if flaw:
            return MetricResult(self.name, label, nan, "J", flaw)
        ends: Sequence[tuple[Array, Array]] = [
            (each[i].x, each[i + 1].x) for i in range(0, len(each), 2)
        ]
        for force, rate in ends:
            if force.shape != rate.shape:
                raise ScenarioError("a force and its velocity differ in size", place)
        t = each[0].t
        E = observer(t, ends)
        power = np.einsum("ij,ij->i", *ends[0])
        put_in = float(running_integral(np.maximum(power, 0.0), t)[-1])
        least = float(E.min())
        parts = {"final": float(E[-1]), "put_in": put_in}
        if put_in > 0:
            parts["least_share"] = least / put_in
        words = f"at {time_text(t[int(np.argmin(E))])}"
        more = ((f"{label}, end", f"{E[-1]:.4g} J at {time_text(t[-1])}"),)
        return MetricResult(self.name, label, least, "J", words, parts, more)
