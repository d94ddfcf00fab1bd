"""Connections of components: wires, links and edge weights, checked for shape and unit.

Endpoints are written ``component.port`` or ``component.port[i]``: entries are counted from 0, those
of an FMU as its description names them. Every error names its place in the scenario.
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property, lru_cache
from math import prod
from typing import TYPE_CHECKING, Any, Literal

from cosim.base.convert import Struct, numbers
from cosim.base.errors import ScenarioError, UnitError
from cosim.base.names import unknown as unknown
from cosim.base.units import Unit, conversion, unit_text
from cosim.fmi.components import has_unit, is_text, text_type, unit_of
from cosim.scenario.component_types import Sort
from cosim.scenario.spec import InputSpec, Scenario
from cosim.schedule.parts import Link, Player, Slot, Step, Wire

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cosim.graphs.topology import Topology, WeightStream

_ENDPOINT = re.compile(r"([A-Za-z_]\w*)\.(.+?)(?:\[(\d+(?:,\d+)*)\])?$")
Causality = Literal["input", "output"]


class ScenarioComponents(Struct, frozen=True, dict=True):
    """The components of a scenario by name, its base step `h` and `start` (s), and its `ticks`."""

    scenario: Scenario
    steps: Mapping[str, Step]
    h: float
    ticks: int
    sorts: Mapping[str, Sort]  # by the name of the component
    start: float = 0.0

    @cached_property
    def slots(self) -> Mapping[Causality, Mapping[str, Slot]]:
        """The slots of inputs and outputs, by ``component.port``."""
        steps = self.steps.values()
        return {
            "input": {s.name: s for step in steps for s in step.inputs},
            "output": {s.name: s for step in steps for s in step.outputs},
        }

    @cached_property
    def fits(self) -> dict[Hashable, tuple[float, float]]:
        """Factors and offsets between units, found so far."""
        return {}

    def endpoint(self, text: str, causality: Causality, place: str) -> Slot:
        """The slot an endpoint names. Raises ScenarioError at `place`."""
        whole = self.slots[causality].get(text)
        if whole is not None:
            return whole  # also an entry of what is no whole array: an FMU's variable ``u[3]``
        match = _ENDPOINT.match(text)
        if match is None:
            raise ScenarioError(f"{text!r} is not an endpoint; expected 'component.port'", place)
        name, port, index = match[1], match[2], match[3]
        if name not in self.steps:
            raise ScenarioError(unknown(name, self.steps, "component"), place)
        slot = self.slots[causality].get(f"{name}.{port}")
        if slot is None:
            component = self.steps[name].component
            if is_text(component, port):
                raise ScenarioError(
                    f"{name}.{port} is a String or Binary variable; expected a number or Boolean: "
                    f"texts are connected as inputs and outputs of FMUs, and it is no {causality}",
                    place,
                )
            other: Causality = "output" if causality == "input" else "input"
            if f"{name}.{port}" in self.slots[other]:
                raise ScenarioError(f"{name}.{port} is not an {causality}", place)
            step = self.steps[name]
            ports = [s.port for s in (step.inputs if causality == "input" else step.outputs)]
            raise ScenarioError(unknown(port, ports, f"{causality} of {name}"), place)
        return part(slot, index, place) if index else slot

    def unit(self, slot: Slot) -> str | Unit:
        """The unit of a slot, by the definition of its FMU if it has one."""
        return unit_of(self.steps[slot.component].component, slot.unit)

    def has_unit(self, slot: Slot) -> bool:
        """True if a unit is declared for a slot."""
        return has_unit(self.steps[slot.component].component, slot.port)

    def values(self, slot: Slot, value: Any, place: str) -> tuple[float, ...]:
        """A value of the file for a slot, flattened, in the slot's unit. Raises ScenarioError."""
        return numbers(value, slot.shape, slot.units or self.unit(slot), place)

    def held(self, slot: Slot) -> float:
        """The value that a scalar input holds until something changes it."""
        step = self.steps[slot.component]
        whole = self.slots["input"][f"{slot.component}.{slot.port}"]
        port = next(p for p in step.component.inputs if p.name == slot.port)
        start = step.start.get(slot.port) or port.default or (0.0,) * port.size
        return start[slot.start - whole.start]

    def scalar_input(self, text: str, place: str) -> Slot:
        """An input that is one number. Raises ScenarioError if it has several entries."""
        slot = self.endpoint(text, "input", place)
        if slot.size != 1:
            raise ScenarioError(f"{slot.name} has {slot.size} entries; expected one", place)
        return slot


def part(slot: Slot, index: str, place: str) -> Slot:
    """An entry, or a row, of a slot: `index` as in ``1,2``. Raises ScenarioError at `place`."""
    found = _row(slot.shape, slot.base, index)
    if found is None:
        between = " to ".join(
            dict.fromkeys((slot.scalars() or ("none",))[:: max(1, slot.size - 1)])
        )
        raise ScenarioError(
            f"[{index}] is outside of {slot.name}, which has shape {list(slot.shape)}: {between}",
            place,
        )
    start, shape = found
    name = f"{slot.name}[{index}]"
    units = slot.units[start : start + prod(shape)]
    at = slot.start + start
    return Slot(name, slot.component, slot.port, at, shape, slot.unit, slot.base, units)


@lru_cache(maxsize=1024)
def _row(shape: tuple[int, ...], base: int, index: str) -> tuple[int, tuple[int, ...]] | None:
    """The place and the shape of an entry, or a row, of an array; None: it is outside."""
    at = tuple(int(i) - base for i in index.split(","))
    if len(at) > len(shape) or any(not 0 <= i < n for i, n in zip(at, shape, strict=False)):
        return None
    start = 0
    for i in at:
        shape = shape[1:]
        start += i * prod(shape)
    return start, shape


# ---- wires ----------------------------------------------------------------------------------


def wires(parts: ScenarioComponents) -> list[Wire]:
    """The wires in the components' `inputs`. Raises ScenarioError."""
    found = []
    components = parts.scenario.place("components")
    for name, spec in parts.scenario.components.items():
        for port, given in spec.inputs.items():
            place = f"{components}.{name}.inputs.{port}"
            wire = given if isinstance(given, InputSpec) else InputSpec(source=given)
            if wire is given or not given:  # there is nothing to check of a source alone
                _check_input(wire, place)
            if not wire.source:
                continue
            target = parts.endpoint(f"{name}.{port}", "input", place)
            source = parts.endpoint(wire.source, "output", place)
            gain, offset = fit(parts, source, target, place)
            scaled = (wire.gain, wire.offset) != (1.0, 0.0)
            if scaled and is_text(parts.steps[name].component, port):
                raise ScenarioError("found gain or offset, which texts do not have", place)
            found.append(Wire(source, target, wire.gain * gain, wire.gain * offset + wire.offset))
    return found


def _check_input(spec: InputSpec, place: str) -> None:
    given = [
        k for k, v in (("from", spec.source), ("table", spec.table), ("points", spec.points)) if v
    ]
    if len(given) != 1:
        text = f"found {' and '.join(given) or 'none'} of from, table, points; expected one of them"
        raise ScenarioError(text, place)
    timed = {"column": spec.column, "interpolate": spec.interpolate != "hold"}
    for key, value in timed.items():
        if value and (given == ["from"] or (key == "column" and given == ["points"])):
            raise ScenarioError(f"found {key} with {given[0]}, which has none", place)


def fit(parts: ScenarioComponents, source: Slot, target: Slot, place: str) -> tuple[float, float]:
    """(gain, offset) between two slots of one shape. Raises ScenarioError.

    Where one of them is a variable of an FMU for which no unit is declared, the number is taken as
    it is (``cosim check`` names such connections).
    """
    sorts = parts.sorts[source.component], parts.sorts[target.component]
    key = (*sorts, *((s.port, s.shape, s.units, "[" in s.name) for s in (source, target)))
    if key not in parts.fits:
        parts.fits[key] = _fit(parts, source, target, place)
    return parts.fits[key]


def _fit(parts: ScenarioComponents, source: Slot, target: Slot, place: str) -> tuple[float, float]:
    kinds = [text_type(parts.steps[s.component].component, s.port) for s in (source, target)]
    if kinds[0] != kinds[1]:
        said = [f"{k} variable" if k else "number" for k in kinds]
        raise ScenarioError(
            f"{source.name} is a {said[0]}, {target.name} expects a {said[1]}", place
        )
    if source.shape != target.shape:
        raise ScenarioError(
            f"{source.name} has shape {list(source.shape)}, {target.name} expects "
            f"{list(target.shape)}",
            place,
        )
    if source.unit == target.unit and _of_any_joints(source, target):
        return 1.0, 0.0
    if source.units or target.units:
        return _fit_entries(parts, source, target, place)
    try:
        return conversion(parts.unit(source), parts.unit(target))
    except UnitError:
        if not (parts.has_unit(source) and parts.has_unit(target)):
            return 1.0, 0.0
        raise ScenarioError(
            f"units do not fit: {source.name} is in [{source.unit}], {target.name} expects "
            f"[{target.unit}]",
            place,
        ) from None


def _of_any_joints(source: Slot, target: Slot) -> bool:
    """True unless the units of entries have to be compared, of two slots in one unit.

    A law for a vector of joints does not know which of them slide; a component with one number
    does.
    """
    known = [bool(s.units) or not (s.shape or "[" in s.name) for s in (source, target)]
    return not all(known) or not (source.units or target.units)


def _fit_entries(
    parts: ScenarioComponents, source: Slot, target: Slot, place: str
) -> tuple[float, float]:
    """(gain, offset) of slots whose entries have units of their own. Raises ScenarioError."""
    found = {}
    for i, names in enumerate(zip(source.scalars(), target.scalars(), strict=True)):
        units = [s.units[i] if s.units else parts.unit(s) for s in (source, target)]
        try:
            found[conversion(*units)] = names
        except UnitError:
            raise ScenarioError(
                f"units do not fit: {names[0]} is in [{unit_text(units[0])}], {names[1]} expects "
                f"[{unit_text(units[1])}]",
                place,
            ) from None
    if len(found) > 1:
        (a, _), (b, _) = list(found.values())[:2]
        raise ScenarioError(
            f"{a} and {b} need different factors of their units; expected a connection of each",
            place,
        )
    return next(iter(found), (1.0, 0.0))


# ---- edge weights ---------------------------------------------------------------------------


class EdgeWeight(Struct, frozen=True):
    """The weight of an edge (i, j), i receives from j, at the receiver's hits."""

    topology: Topology
    edge: tuple[int, int]
    period: int
    h: float

    def stream(self) -> _Column:
        """The weights from the first hit on."""
        receiver, sender = self.edge
        return _Column(self.topology.weights(receiver, [sender], period=self.period, h=self.h))

    def facts(self) -> dict[str, Any]:
        """The edge, and how the graphs switch; the graphs themselves if they are small."""
        from cosim.graphs.graph import MATRIX

        small = self.topology.n <= MATRIX
        facts = self.topology.facts() if small else self.topology.switching_facts()
        return {"edge": list(self.edge), **facts}


class _Column:
    """The only column of a stream of rows."""

    def __init__(self, stream: WeightStream) -> None:
        self._stream = stream

    def rows(self, n: int) -> NDArray[np.float64]:
        """The next `n` weights."""
        return self._stream.rows(n)[:, 0]


def topology(scenario: Scenario) -> Topology | None:
    """The [topology] of a scenario, if it has one. Raises ScenarioError."""
    spec = scenario.topology
    if spec is None:
        return None
    from cosim.graphs.topology import make_topology

    return make_topology(
        graphs=spec.graphs,
        dwell=spec.dwell,
        schedule=spec.schedule,
        repeat=spec.repeat,
        seed=scenario.run.seed,
        folder=scenario.path.parent,
        place=scenario.place("topology"),
    )


def weight_players(parts: ScenarioComponents) -> list[Player]:
    """The players of the table [topology.weights]: an input, and the edge whose weight it gets.

    Raises ScenarioError for an edge of a robot that does not exist.
    """
    found = topology(parts.scenario)
    if found is None or parts.scenario.topology is None:
        return []
    result = []
    for text, edge in parts.scenario.topology.weights.items():
        place = parts.scenario.place("topology", "weights", text)
        target = parts.scalar_input(text, place)
        for robot in edge:
            if not 1 <= robot <= found.n:
                raise ScenarioError(f"there is no robot {robot}; expected 1 to {found.n}", place)
        period = parts.steps[target.component].period
        result.append(Player(target, EdgeWeight(found, edge, period, parts.h)))
    return result


# ---- everything that is fed -----------------------------------------------------------------


def check_single_sources(
    parts: ScenarioComponents,
    wires: Sequence[Wire],
    links: Sequence[Link],
    players: Sequence[Player],
) -> None:
    """Raise ScenarioError for an input with two sources, or with a source and a start value."""
    fed = [(w.target, w.source.name) for w in wires]
    fed += [(x.target, x.source.name) for x in links]
    fed += [(x.age, f"the age of {x.name}") for x in links if x.age is not None]
    fed += [(p.target, _origin(p)) for p in players]
    sources: dict[int, str] = {}
    for target, source in fed:
        for at in range(target.start, target.start + target.size):
            if at in sources:
                scalar = target.scalars()[at - target.start]
                raise ScenarioError(
                    f"{scalar} is fed twice: by {sources[at]} and by {source}",
                    str(parts.scenario.path),
                )
            sources[at] = source
    events = {p.target.name for p in players if "events" in p.source.facts()}  # start from these
    names = {target.name for target, _ in fed} - events
    for step in parts.steps.values():
        for port in step.start:
            if f"{step.name}.{port}" in names:
                raise ScenarioError(
                    f"{step.name}.{port} is fed by a connection; a start value would not be used",
                    parts.scenario.place("components", step.name, "start", port),
                )


def _origin(player: Player) -> str:
    return str(player.source.facts().get("from", "a weight of the topology"))
