"""A flattened SSP as the document of a scenario: what ``cosim run system.ssp`` runs."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from cosim.base.errors import CosimError, ScenarioError, UnitError
from cosim.base.settings import change
from cosim.base.units import Unit, conversion
from cosim.fmi import FmuComponent
from cosim.fmi.ports import VariableGroup
from cosim.fmi.values import item
from cosim.fmi.variables import TEXTS
from cosim.scenario.connect import unknown
from cosim.scenario.spec import Scenario, build
from cosim.ssp import annotation
from cosim.ssp.archive import unpack
from cosim.ssp.structure import Connector, SspConnection, Structure, read
from cosim.ssp.values import SspValue

#: Where an SSP says how long a step of the master is (local names of elements).
_MASTERS = ("FixedStepMaster", "FixedStepSolver")


def load(path: str | Path, settings: Sequence[str] = ()) -> Scenario:
    """Read an SSP as a scenario and apply ``path=value`` settings. Raises ScenarioError.

    Its algorithm is jacobi, as in other tools, unless our annotation says otherwise. Nested systems
    are flattened: ``outer.arm`` becomes the component ``outer_arm``.
    """
    path = Path(path)
    made = document(path)
    for setting in settings:
        change(made, setting)
    for key, hint in (("step", "1 ms"), ("stop", "10 s")):
        if key not in made["run"]:
            message = f"the SSP does not say {key}; say --set run.{key}='\"{hint}\"'"
            raise ScenarioError(message, str(path))
    return build(made, path)


def document(path: str | Path) -> dict[str, Any]:
    """An SSP as the document of a scenario; `run` may lack step and stop.

    Raises ScenarioError if the SSP cannot be read or does not start at 0 s.
    """
    path = Path(path)
    folder = unpack(path)
    structure = read(folder, str(path))
    parts = _parts(structure)
    run: dict[str, Any] = {"algorithm": "jacobi"}
    experiment = structure.root.child("DefaultExperiment")
    if experiment is not None:
        if experiment.number("startTime", 0.0) != 0.0:
            start = experiment.get("startTime")
            raise ScenarioError(f"startTime is {start}; expected 0", experiment.place)
        if experiment.get("stopTime"):
            run["stop"] = experiment.number("stopTime")
    step = _step(structure, parts)
    if step is not None:
        run["step"] = step
    made: dict[str, Any] = {
        "title": structure.root.get("name") or path.stem,
        "run": run,
        "components": {part.name: part.table() for part in parts.values()},
    }
    fed = {target for target in structure.edges if _feed(structure, parts, target)}
    for connector, value in structure.values.items():
        if connector[0] in parts and connector not in fed:
            parts[connector[0]].set(connector[1], value)
    said = annotation.read(structure.root)
    return annotation.apply(said, made, folder) if said is not None else made


def _step(structure: Structure, parts: Mapping[tuple[str, ...], _Component]) -> float | None:
    """The step in the SSP (s), or else the shortest step that its FMUs propose."""
    for element in structure.root.element.iter():
        tag = element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
        if tag in (*_MASTERS, "DefaultExperiment") and element.get("stepSize"):
            try:
                return float(element.get("stepSize", ""))
            except ValueError:
                text = element.get("stepSize")
                raise ScenarioError(
                    f"stepSize {text!r} is no number", structure.root.place
                ) from None
    steps = [p.fmu.description.default_step for p in parts.values()]
    return min((s for s in steps if s), default=None)


# ---- components -----------------------------------------------------------------------------


def _parts(structure: Structure) -> dict[tuple[str, ...], _Component]:
    found: dict[tuple[str, ...], _Component] = {}
    names: set[str] = set()
    for path, part in structure.parts.items():
        name = re.sub(r"\W", "_", "_".join(path))
        name = name if not name[0].isdigit() else f"_{name}"
        while name in names:
            name += "_"
        names.add(name)
        try:
            fmu = FmuComponent(part.fmu, name)
        except CosimError as error:
            raise ScenarioError(str(error), part.place) from None
        found[path] = _Component(name, fmu, part.place)
    if not found:
        raise ScenarioError("no components", structure.system.place)
    return found


class _Component:
    """A component to be: FMI variables by name, and the tables that are filled."""

    def __init__(self, name: str, fmu: FmuComponent, place: str) -> None:
        self.name, self.fmu, self._place = name, fmu, place
        self._variables = dict(_variables(fmu))
        self._inputs: dict[str, Any] = {}
        self._values: dict[str, Any] = {}

    def table(self) -> dict[str, Any]:
        """Its table in the document; inputs and values appear in it later."""
        path = str(self.fmu.archive.path)
        return {"model": path, "inputs": self._inputs, "parameters": self._values}

    def variable(self, name: str, place: str) -> tuple[VariableGroup, tuple[int, ...]]:
        """The signal a variable is in, and its index there (0-based). Raises ScenarioError."""
        if name not in self._variables:
            raise ScenarioError(unknown(name, self._variables, f"variable of {self.name}"), place)
        return self._variables[name]

    def endpoint(self, name: str, place: str) -> str:
        """``component.port`` or ``component.port[i]`` of a variable."""
        group, index = self.variable(name, place)
        return f"{self.name}.{group.name}{_brackets(index)}"

    def unit(self, name: str, place: str) -> Unit | str:
        """The unit of a variable."""
        return self.fmu.unit(self.variable(name, place)[0].first.unit or "1")

    def feed(self, name: str, wire: Any, place: str) -> None:
        """Wire an input."""
        group, index = self.variable(name, place)
        self._inputs[f"{group.name}{_brackets(index)}"] = wire

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
            self._values[group.name] = _nested(many, group.shape)
            return
        if len(entries) != 1:
            raise ScenarioError(f"{len(entries)} entries, expected one", value.place)
        nested = self._values.setdefault(group.name, _nested(_starts(group), group.shape))
        for i in index[:-1]:
            nested = nested[i]
        nested[index[-1]] = entries[0]

    def _entries(self, group: VariableGroup, value: SspValue) -> list[Any]:
        if group.first.type in TEXTS:
            return list(value.entries)
        try:
            numbers = [_number(group, entry) for entry in value.entries]
        except (ValueError, CosimError):
            message = f"{' '.join(value.entries)!r} is no value of {self.name}.{group.name}"
            raise ScenarioError(message, value.place) from None
        gain, offset = 1.0, 0.0
        if value.unit is not None and not value.suppress and group.first.unit:
            try:
                gain, offset = conversion(value.unit, self.fmu.unit(group.first.unit or "1"))
            except UnitError as error:
                raise ScenarioError(f"{self.name}.{group.name}: {error}", value.place) from None
        return [value.factor * (gain * x + offset) + value.offset for x in numbers]


def _variables(fmu: FmuComponent) -> Iterator[tuple[str, tuple[VariableGroup, tuple[int, ...]]]]:
    for group in fmu.groups.values():
        if len(group.variables) == 1 and group.first.name == group.name:
            yield group.name, (group, ())
        else:
            indices = product(*(range(n) for n in group.shape))
            for variable, index in zip(group.variables, indices, strict=True):
                yield variable.name, (group, index)


def _brackets(index: tuple[int, ...]) -> str:
    return f"[{','.join(map(str, index))}]" if index else ""


def _number(group: VariableGroup, text: str) -> float:
    if group.first.type == "Enumeration" and text in group.first.items:
        return float(item(group, text))
    return {"true": 1.0, "false": 0.0}[text] if text in ("true", "false") else float(text)


def _starts(group: VariableGroup) -> list[float]:
    return [_number(group, text) for text in group.start] or [0.0] * group.size


def _nested(values: Sequence[Any], shape: tuple[int, ...]) -> Any:
    if not shape:
        return values[0]
    part = len(values) // shape[0] if shape[0] else 0
    return [_nested(values[i * part : (i + 1) * part], shape[1:]) for i in range(shape[0])]


# ---- connections ----------------------------------------------------------------------------


def _feed(
    structure: Structure, parts: Mapping[tuple[str, ...], _Component], target: Connector
) -> bool:
    """Wire an input to the output at the beginning of its connections; whether there is one."""
    path, name = target
    if path not in parts:
        return False  # a station on the way
    source, way = _traced(structure, parts, target)
    if source[0] in parts:
        wire = _wire(parts[source[0]], source[1], parts[path], name, way)
        parts[path].feed(name, wire, way.place)
    elif source in structure.values:
        value = structure.values[source].through(way.factor, way.offset, way.suppress)
        parts[path].set(name, value)
    else:
        return False
    return True


def _traced(
    structure: Structure, parts: Mapping[tuple[str, ...], _Component], target: Connector
) -> tuple[Connector, SspConnection]:
    """Where the connections to `target` begin, and all of them as one edge."""
    way = structure.edges[target]
    passed = {target}
    while way.source in structure.edges and way.source[0] not in parts:
        if way.source in passed:
            raise ScenarioError("connections form a loop without a component", way.place)
        passed.add(way.source)
        before = structure.edges[way.source]
        way = SspConnection(
            before.source,
            way.factor * before.factor,
            way.factor * before.offset + way.offset,
            way.suppress or before.suppress,
            way.place,
        )
    return way.source, way


def _wire(
    sender: _Component, output: str, receiver: _Component, name: str, way: SspConnection
) -> Any:
    """The entry of a scenario for a connection: an endpoint, or one with gain and offset."""
    for part, variable, expected in ((sender, output, "output"), (receiver, name, "input")):
        found = part.variable(variable, way.place)[0].first.causality
        if found != expected:
            message = f"{part.name}.{variable} is a {found} of its FMU, no {expected}"
            raise ScenarioError(message, way.place)
    factor, offset = way.factor, way.offset
    units = [
        p.variable(v, way.place)[0].first.unit for p, v in ((sender, output), (receiver, name))
    ]
    if way.suppress and all(units):
        try:  # what the wire would convert by, and must not
            gain, shift = conversion(sender.unit(output, way.place), receiver.unit(name, way.place))
        except UnitError as error:
            message = f"{error}; suppressing the conversion does not make them the same"
            raise ScenarioError(message, way.place) from None
        factor, offset = factor / gain, offset - factor / gain * shift
    origin = sender.endpoint(output, way.place)
    plain = (factor, offset) == (1.0, 0.0)
    return origin if plain else {"from": origin, "gain": factor, "offset": offset}
