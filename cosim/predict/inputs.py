"""Values that an input of a component receives: from the plan, or from a run with its sources.

By default a run records outputs, and not the inputs that wires copy them into. The torque that an
operator component feeds into an arm is such an input, so it is computed from its sources here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from math import inf
from typing import final

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.record.piecewise import pieces
from cosim.record.signals import Array, Signals
from cosim.schedule.parts import Link, Player, Slot, Step, Wire
from cosim.schedule.plan import Plan


def feeders(plan: Plan, slot: Slot) -> tuple[Wire | Link | Player, ...]:
    """All wires, links and players that feed a part of an input."""
    return plan.feeders(slot.start, slot.size)


def is_driven(plan: Plan, name: str) -> bool:
    """True if anything feeds the input `name`, or the scenario holds it at other than 0."""
    slot = plan.slots().get(name)
    if slot is None:
        return False
    return bool(feeders(plan, slot)) or any(start_value(plan.component(slot.component), slot))


def start_value(step: Step, slot: Slot) -> tuple[float, ...]:
    """The value of an input that nothing feeds, one number per entry, in its unit."""
    port = next(p for p in step.component.inputs if p.name == slot.port)
    return step.start.get(slot.port) or port.default or (0.0,) * slot.size


@final
class RunWithInputs:
    """A recorded run that also answers for inputs which were not recorded themselves."""

    def __init__(self, run: Signals, plan: Plan, slots: Mapping[str, Slot] | None = None) -> None:
        self.run = run
        self._plan = plan
        self._slots = plan.slots() if slots is None else slots

    def pieces(self, names: Sequence[str], since: float = -inf) -> Iterator[RunWithInputs]:
        """The rows in pieces with these signals, as :func:`cosim.record.piecewise.pieces`.

        `since`: the time, s, from which on they are needed.
        """
        recorded = [part for name in names for part in self._sources(name)]
        for piece in pieces(self.run, recorded, since):
            yield RunWithInputs(piece, self._plan, self._slots)

    def _sources(self, name: str) -> Iterator[str]:
        """The signals that are read for one, as far as they were recorded."""
        slot = self._computed(name)
        if slot is None:
            yield name
            return
        for feeder in feeders(self._plan, slot):
            if isinstance(feeder, Wire):
                with suppress(ScenarioError):
                    self.run.entries(feeder.source.name)
                    yield feeder.source.name

    @property
    def t(self) -> Array:
        """Time of each row, (n,), s."""
        return self.run.t

    def array(self, prefix: str) -> Array:
        """Entries of a signal, (n, m), in its unit.

        Raises ScenarioError for an input whose sources were not recorded.
        """
        slot = self._computed(prefix)
        return self.run.array(prefix) if slot is None else self._input(slot)

    def entries(self, prefix: str) -> tuple[str, ...]:
        """Names of those entries. Raises ScenarioError for a signal that is not there."""
        slot = self._computed(prefix)
        return self.run.entries(prefix) if slot is None else slot.scalars()

    def unit(self, prefix: str) -> str:
        """Unit of a signal. Raises ScenarioError for a signal that is not there."""
        slot = self._computed(prefix)
        return self.run.unit(prefix) if slot is None else slot.unit

    def _computed(self, prefix: str) -> Slot | None:
        """The input `prefix`, if it was not recorded."""
        try:
            self.run.entries(prefix)
        except ScenarioError:
            slot = self._slots.get(prefix)
            inputs = self._plan.component(slot.component).inputs if slot is not None else ()
            return slot if slot in inputs else None
        return None

    def _input(self, slot: Slot) -> Array:
        """An input, (n, m): its start value, overwritten by the wires that feed it."""
        start = start_value(self._plan.component(slot.component), slot)
        found = np.tile(np.asarray(start, dtype=np.float64), (len(self.t), 1))
        for feeder in feeders(self._plan, slot):
            if not isinstance(feeder, Wire):
                raise ScenarioError(
                    f"{slot.name} was not recorded, and a link or a table feeds it;"
                    f" record {slot.name} as well"
                )
            first = feeder.target.start - slot.start
            values = self._source(feeder, slot)
            found[:, first : first + feeder.target.size] = feeder.gain * values + feeder.offset
        return found

    def _source(self, wire: Wire, slot: Slot) -> Array:
        try:
            return self.run.array(wire.source.name)
        except ScenarioError as error:
            raise ScenarioError(
                f"{slot.name} is fed by {wire.source.name}, and neither was recorded;"
                f" expected one of them in run.record.signals"
            ) from error
