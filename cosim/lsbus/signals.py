"""The signals of an FMU on a bus, besides its frames: set and read between its steps."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from cosim.base.component import Outputs, Port, Values
from cosim.base.errors import FmuError
from cosim.fmi.component import FmuComponent
from cosim.lsbus.terminals import CanTerminal


@final
class NodeSignals:
    """Inputs and outputs of an FMU, without the clocks and operations of its CAN terminal.

    Raises FmuError for an FMU with other clocks.
    """

    def __init__(self, fmu: FmuComponent, terminal: CanTerminal) -> None:
        self._fmu = fmu
        self._check_clocks(terminal)
        self.inputs = self._numbers(fmu.inputs)
        self.outputs = self._numbers(fmu.outputs)
        self._discrete = fmu.discrete
        self._outputs = {g.name: g for g in fmu.carried("output")}
        self._last: dict[str, list[float]] = {}
        self._jumps: dict[str, list[float]] = {}

    def initial(self, u: Values) -> Outputs:
        """Outputs in Initialization Mode for inputs `u`, each of its port's shape."""
        self._last, self._jumps = {name: flat(value) for name, value in u.items()}, {}
        found = self._fmu.initial(u)
        return {p.name: found[p.name] for p in self.outputs}

    def set(self, u: Values) -> bool:
        """Set the inputs that differ from the last time; whether an Event Mode has to follow.

        It has to where an input that changes in jumps only is new: :meth:`set_jumps` sets it there.
        """
        for name, value in u.items():
            new = flat(value)
            if new == self._last.get(name):
                continue
            self._last[name] = new
            if name in self._discrete:
                self._jumps[name] = new
            else:
                self._set(name, new)
        return bool(self._jumps)

    def set_jumps(self) -> None:
        """Set what :meth:`set` has left to the Event Mode."""
        for name, values in self._jumps.items():
            self._set(name, values)
        self._jumps = {}

    def read(self) -> Outputs:
        """Outputs as they stand, each of its port's shape."""
        instance, found = self._fmu.instance, {}
        for p in self.outputs:
            group = self._outputs[p.name]
            values = instance.get(group.first.type, group.references, group.size)
            found[p.name] = np.array(values).reshape(p.shape)
        return found

    def _set(self, name: str, values: list[float]) -> None:
        group = self._fmu.groups[name]
        self._fmu.instance.set(group.first.type, group.references, values)

    def _numbers(self, ports: tuple[Port, ...]) -> tuple[Port, ...]:
        return tuple(p for p in ports if self._fmu.groups[p.name].first.type != "Clock")

    def _check_clocks(self, terminal: CanTerminal) -> None:
        own = {terminal.tx_clock.name, terminal.rx_clock.name}
        data = {terminal.tx_data.name, terminal.rx_data.name}
        for v in self._fmu.description.variables:
            if (v.type == "Clock" and v.name not in own) or (v.clocks and v.name not in data):
                raise FmuError(
                    f"{self._fmu.name}: found {v.name!r}, which is a clock or belongs to one,"
                    " expected no clocks but those of the CAN terminal"
                )


def flat(value: Any) -> list[float]:
    """A value of any shape as its scalars, in the unit it has."""
    return [float(v) for v in np.ravel(value)]
