"""Components of an SSP: FMUs, their variables by name, and the tables of the scenario they fill."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any

from cosim.base.errors import CosimError, ScenarioError, UnitError
from cosim.base.units import Unit, conversion, is_unit, unit_text
from cosim.fmi import FmuComponent, FmuOptions
from cosim.fmi.file import binaries
from cosim.fmi.file.ports import VariableGroup
from cosim.fmi.file.values import item
from cosim.fmi.file.variables import TEXTS
from cosim.scenario.component_types import nested
from cosim.scenario.connect import unknown
from cosim.ssp.structure import SspComponent, Structure
from cosim.ssp.values import SspValue

#: Kinds of components for interfaces that an SSD names; co-simulation needs none.
_KINDS = {"ModelExchange": "model exchange", "ScheduledExecution": "scheduled execution"}


def components(structure: Structure) -> dict[tuple[str, ...], SspPart]:
    """The components of a structure by their names from the outside in. Raises ScenarioError."""
    found: dict[tuple[str, ...], SspPart] = {}
    names: set[str] = set()
    for path, part in structure.parts.items():
        name = re.sub(r"\W", "_", "_".join(path))
        name = name if not name[0].isdigit() else f"_{name}"
        while name in names:
            name += "_"
        names.add(name)
        found[path] = SspPart(name, _fmu(part, name), part.place)
    if not found:
        raise ScenarioError("no components", structure.system.place)
    return found


def _fmu(part: SspComponent, name: str) -> FmuComponent:
    """The FMU of a component, as the SSD says that it is run. Raises ScenarioError."""
    wanted = part.implementation
    options = FmuOptions(interface=wanted if wanted in _KINDS else "")
    try:
        fmu = FmuComponent(part.fmu, name, options=options)
    except CosimError as error:
        raise ScenarioError(str(error), part.place) from None
    if wanted not in ("any", *fmu.description.interfaces):
        there = ", ".join(fmu.description.interfaces)
        message = f"implementation is {wanted!r}, but the FMU has {there}"
        raise ScenarioError(message, part.place)
    return fmu


class SspPart:
    """A component to be: FMI variables by name, and the tables that are filled."""

    def __init__(self, name: str, fmu: FmuComponent, place: str) -> None:
        self.name, self.fmu, self._place = name, fmu, place
        self._variables = dict(_variables(fmu))
        #: Sentences about what is given and not used.
        self.ignored: list[str] = []
        self._inputs: dict[str, Any] = {}
        self._values: dict[str, Any] = {}

    def table(self) -> dict[str, Any]:
        """Its table in the document; inputs and values appear in it later."""
        found: dict[str, Any] = {"model": str(self.fmu.archive.path)}
        if self.fmu.options.interface:
            found["kind"] = _KINDS[self.fmu.options.interface]
        archive, described = self.fmu.archive, self.fmu.description
        shipped = binaries.shipped(archive, described.fmi, described.identifier)
        if not shipped and binaries.has_sources(archive):
            found["build"] = True
        return {**found, "inputs": self._inputs, "parameters": self._values}

    @property
    def names(self) -> Iterable[str]:
        """Names of all variables."""
        return self._variables

    def has(self, name: str) -> bool:
        """True if there is a variable of that name."""
        return name in self._variables

    def variable(self, name: str, place: str) -> tuple[VariableGroup, tuple[int, ...]]:
        """The signal a variable is in, and its index there (0-based). Raises ScenarioError."""
        if name not in self._variables:
            raise ScenarioError(unknown(name, self._variables, f"variable of {self.name}"), place)
        return self._variables[name]

    def group(self, name: str) -> VariableGroup:
        """The signal that a variable is in. Raises KeyError."""
        return self._variables[name][0]

    def endpoint(self, name: str, place: str) -> str:
        """``component.port`` or ``component.port[i]`` of a variable."""
        group, index = self.variable(name, place)
        return f"{self.name}.{group.name}{_brackets(group, index)}"

    def unit(self, name: str, place: str) -> Unit | str:
        """The unit of a variable."""
        return self.fmu.unit(self.variable(name, place)[0].first.unit or "1")

    def feed(self, name: str, wire: Any, place: str) -> None:
        """Wire an input."""
        group, index = self.variable(name, place)
        self._inputs[f"{group.name}{_brackets(group, index)}"] = wire

    def set(self, name: str, value: SspValue) -> None:
        """Set a parameter or start value. Raises ScenarioError."""
        group, index = self.variable(name, value.place)
        entries = self._entries(group, value)
        if group.first.type in TEXTS:
            if index:
                message = f"{self.name}.{name}: entries of an array of texts are not supported"
                raise ScenarioError(message, value.place)
            self._values[group.name] = entries[0]
            return
        if not index:
            many = entries if len(entries) != 1 else entries * group.size
            if len(many) != group.size:
                raise ScenarioError(f"{len(many)} entries, expected {group.size}", value.place)
            self._values[group.name] = nested(many, group.shape)
            return
        if len(entries) != 1:
            raise ScenarioError(f"{len(entries)} entries, expected one", value.place)
        rows = self._values.setdefault(group.name, nested(_starts(group), group.shape))
        for i in index[:-1]:
            rows = rows[i]
        rows[index[-1]] = entries[0]

    def _entries(self, group: VariableGroup, value: SspValue) -> list[Any]:
        if group.first.type in TEXTS:
            return list(value.entries)
        try:
            numbers = [number_of(group, entry) for entry in value.entries]
        except (ValueError, CosimError):
            message = f"{' '.join(value.entries)!r} is no value of {self.name}.{group.name}"
            raise ScenarioError(message, value.place) from None
        gain, offset = self._conversion(group, value)
        return [value.factor * (gain * x + offset) + value.offset for x in numbers]

    def _conversion(self, group: VariableGroup, value: SspValue) -> tuple[float, float]:
        """(gain, offset) into the unit of a variable. Raises ScenarioError."""
        given, own = value.unit, group.first.unit
        if given is None or given == own or value.suppress or not own:
            return 1.0, 0.0
        target = self.fmu.unit(own)
        for unit in (given, target):
            if isinstance(unit, str) and not is_unit(unit):
                self.ignored.append(
                    f"{self.name}.{group.name} is given in {unit_text(given)!r} and has the unit "
                    f"{own!r}: {unit!r} is not defined, so the number is taken as it is"
                )
                return 1.0, 0.0
        try:
            return conversion(given, target)
        except UnitError as error:
            raise ScenarioError(f"{self.name}.{group.name}: {error}", value.place) from None


def _variables(fmu: FmuComponent) -> Iterator[tuple[str, tuple[VariableGroup, tuple[int, ...]]]]:
    for group in fmu.groups.values():
        if len(group.variables) == 1 and group.first.name == group.name:
            yield group.name, (group, ())
        else:
            indices = product(*(range(n) for n in group.shape))
            for variable, index in zip(group.variables, indices, strict=True):
                yield variable.name, (group, index)


def _brackets(group: VariableGroup, index: tuple[int, ...]) -> str:
    """An entry as the FMU names it."""
    return f"[{','.join(str(group.base + i) for i in index)}]" if index else ""


def number_of(group: VariableGroup, text: str) -> float:
    """A value of a variable as written, in its unit; items as numbers. Raises ValueError."""
    if group.first.type == "Enumeration" and text in group.first.items:
        return float(item(group, text))
    return {"true": 1.0, "false": 0.0}[text] if text in ("true", "false") else float(text)


def _starts(group: VariableGroup) -> list[float]:
    return [number_of(group, text) for text in group.start] or [0.0] * group.size
