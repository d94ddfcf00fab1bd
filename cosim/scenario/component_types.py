"""Sorts of components: what those have in common that have the same ports and parameters.

FMUs that differ in their names, values and connections only are of one sort: their ports are the
same objects (:meth:`cosim.fmi.FmuComponent.alike`). What follows from the ports is worked out once
for a sort, and not for each of ten thousand components.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

from cosim.base.component import Component, Parameter, Port
from cosim.base.convert import numbers
from cosim.base.copies import replace
from cosim.base.errors import FmuError, ScenarioError
from cosim.base.names import signal_of, unknown
from cosim.fmi.components import discrete_inputs, fmu_of, sloped_inputs
from cosim.schedule.parts import Slot

#: Inputs, outputs and parameters.
Ports = tuple[tuple[Port, ...], tuple[Port, ...], tuple[Parameter, ...]]
#: A value of the file, and the table in which it is given.
Given = tuple[Any, str]


class Sort:
    """One sort: its parameters and inputs by name, and which inputs are `discrete` and `sloped`."""

    def __init__(self, component: Component, ports: Ports) -> None:
        self._ports = inputs, outputs, parameters = ports
        places = accumulate((p.size for p in (*inputs, *outputs)), initial=0)
        #: Inputs and outputs with their places behind the first, signals.
        self._layout = tuple([(p, next(places)) for p in side] for side in (inputs, outputs))
        self._size = next(places)
        self._fmu = fmu_of(component)
        self._known: dict[str, tuple[Any, tuple[float, ...], tuple[str, ...]]] = {}
        self.inputs = {p.name: p for p in inputs}
        self.parameters = {p.name: p for p in parameters}
        self.discrete = discrete_inputs(component)
        self.sloped = sloped_inputs(component)

    def slots(
        self, name: str, start: int, units: Mapping[str, tuple[str, ...]]
    ) -> tuple[tuple[Slot, ...], tuple[Slot, ...], int]:
        """The slots of inputs and outputs of a component from `start` on, and where they end.

        `units`: of the entries of ports, by the port's name, where they differ from the port's.
        """
        inputs, outputs = (
            tuple(Slot(f"{name}.{p.name}", name, p.name, start + at, p.shape, p.unit, p.base,
                       units.get(p.name, ()))
                  for p, at in side)
            for side in self._layout
        )  # fmt: skip
        return inputs, outputs, start + self._size

    def numbers(
        self, key: str, given: Given, place: str, units: Mapping[str, tuple[str, ...]]
    ) -> tuple[float, ...]:
        """A value of the file for a parameter or an input, flattened, in its unit.

        `given`: the value, and the table of the component at `place` that has it; `units`: as in
        :meth:`slots`. What is the same object for
        several components is converted once. Raises ScenarioError.
        """
        value, table = given
        known, of_entries = self._known.get(key), units.get(key, ())
        if known is not None and known[0] is value and known[2] == of_entries:
            return known[1]
        where = f"{place}.{table}.{key}" if table in ("parameters", "start") else f"{place}.{table}"
        parameter = self.parameters.get(key)
        port = parameter or self.inputs.get(key)
        if port is None:
            names = [*self.parameters, *self.inputs]
            raise ScenarioError(unknown(key, names, "parameter or start"), where)
        found = self._numbers(port, value, where, of_entries)
        if parameter is not None:
            _check_type(parameter, found, where)
        self._known[key] = value, found, of_entries
        return found

    def joined(
        self, given: Mapping[str, Given], place: str, units: Mapping[str, tuple[str, ...]]
    ) -> dict[str, Given]:
        """Given values with those of entries, such as ``q[1]``, put into their arrays.

        `units`: as in :meth:`slots`.
        Raises ScenarioError for an entry that an array has not.
        """
        found = {k: v for k, v in given.items() if self._array(k) is None}
        for key, (value, table) in given.items():
            array = self._array(key)
            if array is None:
                continue
            where = f"{place}.{table}.{key}"
            of_entries = units.get(array.name, ())
            whole, _ = found.get(array.name, (None, table))
            if whole is None:
                entries = list(array.default or (0.0,) * array.size)
            else:
                entries = list(self._numbers(array, whole, where, of_entries))
            at = _place(array, key, where)
            entry, unit = replace(array, shape=()), of_entries[at : at + 1]
            (entries[at],) = self._numbers(entry, value, where, unit)
            found[array.name] = nested(entries, array.shape), table
        return found

    def _array(self, key: str) -> Parameter | Port | None:
        """The array that a key names an entry of."""
        if not key.endswith("]") or key in self.parameters or key in self.inputs:
            return None
        name = signal_of(key)
        found = self.parameters.get(name) or self.inputs.get(name)
        return found if found is not None and found.shape else None

    def _numbers(
        self, p: Parameter | Port, value: Any, place: str, units: tuple[str, ...]
    ) -> tuple[float, ...]:
        """In an FMU with its own units and names of items; `units`: of the entries, or ()."""
        if self._fmu is None:
            return numbers(value, p.shape, units or p.unit, place)
        try:
            value = self._fmu.number(p.name, value)
        except FmuError as error:
            raise ScenarioError(str(error), place) from None
        return numbers(value, p.shape, units or self._fmu.unit(p.unit), place)


def nested(values: Sequence[Any], shape: tuple[int, ...]) -> Any:
    """Flattened values (row-major) as nested lists of `shape`; () is the only one."""
    if not shape:
        return values[0]
    part = len(values) // shape[0] if shape[0] else 0
    return [nested(values[i * part : (i + 1) * part], shape[1:]) for i in range(shape[0])]


def _place(array: Parameter | Port, key: str, place: str) -> int:
    """The place of an entry such as ``q[1,2]`` in the flattened values. Raises ScenarioError."""
    slot = Slot(array.name, "", array.name, 0, array.shape, array.unit, array.base)
    names = slot.scalars()
    if key not in names:
        raise ScenarioError(unknown(key, names, f"entry of {array.name}"), place)
    return names.index(key)


class Sorts:
    """The sorts of the components of a scenario."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, ...], Sort] = {}

    def of(self, component: Component) -> Sort:
        """The sort of a component, which is told by the identity of its ports."""
        ports = component.inputs, component.outputs, component.parameters
        key = tuple(map(id, ports))
        if key not in self._known:
            self._known[key] = Sort(component, ports)  # which keeps them: no other gets their id
        return self._known[key]


def _check_type(parameter: Parameter, values: tuple[float, ...], place: str) -> None:
    if parameter.type == "integer" and any(v != int(v) for v in values):
        raise ScenarioError(f"{parameter.name} is an integer, found {list(values)}", place)
    if parameter.type == "boolean" and any(v not in (0.0, 1.0) for v in values):
        raise ScenarioError(f"{parameter.name} is a Boolean, found {list(values)}", place)
