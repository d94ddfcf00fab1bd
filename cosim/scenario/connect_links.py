"""The links of a scenario: late by a law, or by a simulated CAN bus. Errors name their place."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.base.convert import Struct, numbers
from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import unknown
from cosim.fmi.components import is_text
from cosim.scenario.connect import ScenarioComponents, fit
from cosim.scenario.spec import LinkSpec
from cosim.schedule.parts import Link, Slot, SteppedBus, Wire

if TYPE_CHECKING:
    from cosim.links.table import DrawnTable, TableSpec
    from cosim.links.traces import BusDelays
    from cosim.scenario.bus_frames import FrameOnBus

#: The delays of every link on a bus, by its name.
Simulated = dict[str, "BusDelays"]


class _TableSources(Struct, frozen=True):
    """The sources of the tables of links: delays on buses by the place of the link, tables of the
    links before by what they have in common, and the folder of the scenario.
    """

    simulated: Simulated
    known: dict[Hashable, DrawnTable]
    folder: Path
    late: Mapping[str, float]  # see computing()


def links(parts: ScenarioComponents) -> list[Link]:
    """The links of the table [[links]]. Raises ScenarioError if two have the same name."""
    found: dict[str, Link] = {}
    given = _TableSources(_on_buses(parts), {}, parts.scenario.path.parent, computing(parts))
    array = parts.scenario.place("links")
    for i, spec in enumerate(parts.scenario.links):
        place = f"{array}.{i}"
        link = _link(parts, spec, place, given)
        if link.name in found:
            raise ScenarioError(f"a second link has the name {link.name!r}", place)
        found[link.name] = link
    return list(found.values())


def _on_buses(parts: ScenarioComponents) -> Simulated:
    """The delays of all links that have a bus. Raises ScenarioError."""
    groups, at = _frames(parts)
    if not groups:
        return {}
    from cosim.scenario.buses import simulate_bus

    length = round(parts.h * 1e12) * (parts.ticks + 1)
    done = {
        bus: simulate_bus(parts.scenario, bus, list(frames.values()), length)
        for bus, frames in groups.items()
    }
    return {place: done[bus][name, receiver] for place, (bus, name, receiver) in at.items()}


def computing(parts: ScenarioComponents) -> dict[str, float]:
    """The time that a step takes of each component with the key `compute`, s.

    Its inputs are those of the beginning of the step, and its outputs reach the others that much
    later: by links with this delay in place of wires, and on links in addition to their delay.
    Raises ScenarioError for a component that is continuous, or a time beyond its period.
    """
    found: dict[str, float] = {}
    for name, spec in parts.scenario.components.items():
        if not spec.compute:
            continue
        seconds = parts.scenario.seconds(spec.compute, "components", name, "compute")
        place = f"{parts.scenario.place('components', name)}.compute"
        step = parts.steps[name]
        if step.kind != "sampled":
            raise ScenarioError("found a continuous component, expected a sampled one", place)
        if not 0.0 <= seconds <= step.period * parts.h:
            raise ScenarioError(
                f"found {seconds:g} s, expected 0 to the period of the component, "
                f"{step.period * parts.h:g} s: each step ends before the next one begins",
                place,
            )
        found[name] = seconds
    return found


def computed(parts: ScenarioComponents, wires: Sequence[Wire]) -> tuple[list[Wire], list[Link]]:
    """The wires that remain, and the links in place of those from components that compute.

    Raises ScenarioError for a wire of texts from one of these.
    """
    late = computing(parts)
    if not late:
        return list(wires), []
    from cosim.links.semantics import Grid
    from cosim.links.spec import link_table

    kept, links = [w for w in wires if w.source.component not in late], list[Link]()
    for wire in wires:
        sender, receiver = parts.steps[wire.source.component], parts.steps[wire.target.component]
        if sender.name not in late:
            continue
        place = f"{parts.scenario.place('components', sender.name)}.compute"
        if is_text(sender.component, wire.source.port):
            raise ScenarioError(
                f"{wire.source.name} is a text, which cannot be late; expected numbers", place
            )
        name = f"{wire.source.name}->{wire.target.name}"
        grid = Grid(sender.period, receiver.period, parts.h)
        spec = LinkSpec(
            source=wire.source.name, target=wire.target.name,
            semantics="newest-stamp", delay=_constant(late[sender.name]),
        )  # fmt: skip
        table = link_table(spec, name, parts.scenario.run.seed, grid, Path(), parts.ticks)
        links.append(Link(name, wire.source, wire.target, table, wire.gain, wire.offset))
    return kept, links


def _constant(seconds: float) -> dict[str, Any]:
    return {"law": "constant", "delay": seconds}


def _later(spec: LinkSpec, seconds: float, place: str) -> LinkSpec:
    """The link with the time that its sender computes added to its delay.

    A stored table contains it. Raises ScenarioError for "signal", which rounds delays to samples.
    """
    if not seconds or spec.delay is None or spec.delay.get("law") == "table":
        return spec
    if spec.semantics == "signal":
        raise ScenarioError(
            'found semantics = "signal" on a link from a component with compute, whose delays are '
            'rounded to whole samples of the sender; expected "newest-stamp", or another rule of '
            "packets", f"{place}.semantics"
        )  # fmt: skip
    return spec.delayed({"law": "sum", "of": [_constant(seconds), spec.delay]})


def stepped_buses(parts: ScenarioComponents, links: Sequence[Link]) -> list[SteppedBus]:
    """The buses that are simulated inside the ticks. Raises ScenarioError."""
    groups, at = _frames(parts)
    if not groups:
        return []
    from cosim.scenario.bus_ticks import bus_in_ticks
    from cosim.scenario.buses import in_ticks

    found: list[SteppedBus] = []
    for bus, frames in groups.items():
        if in_ticks(parts.scenario.buses[bus], list(frames.values())):
            mine = [
                (link, *at[place][1:])
                for i, link in enumerate(links)
                if at.get(place := parts.scenario.place("links", i), ("",))[0] == bus
            ]
            found.append(bus_in_ticks(parts, bus, list(frames.values()), mine))
    return found


def frames_on_buses(parts: ScenarioComponents) -> dict[str, list[FrameOnBus]]:
    """The frames of the links, by bus. Raises ScenarioError."""
    return {bus: list(frames.values()) for bus, frames in _frames(parts)[0].items()}


def _frames(
    parts: ScenarioComponents,
) -> tuple[dict[str, dict[str, FrameOnBus]], dict[str, tuple[str, str, str]]]:
    """(frames by bus and name; of each link's place its bus, frame and receiver)."""
    groups: dict[str, dict[str, FrameOnBus]] = {}
    at: dict[str, tuple[str, str, str]] = {}
    late = computing(parts) if parts.scenario.buses else {}
    for i, spec in enumerate(parts.scenario.links):
        if spec.bus:
            place = parts.scenario.place("links", i)
            frames = groups.setdefault(spec.bus, {})
            name, receiver = _add_frame(parts, spec, frames, late, place)
            at[place] = spec.bus, name, receiver
    return groups, at


def _add_frame(
    parts: ScenarioComponents,
    spec: LinkSpec,
    frames: dict[str, FrameOnBus],
    late: Mapping[str, float],
    place: str,
) -> tuple[str, str]:
    """(name of the frame, receiver) of a link, whose frame is put into `frames`."""
    from cosim.scenario.bus_frames import frame_on_bus

    buses = parts.scenario.buses
    if spec.bus not in buses:
        raise ScenarioError(unknown(spec.bus, buses, "bus"), f"{place}.bus")
    for key in ("delay", "loss", "playout"):
        if getattr(spec, key) is not None:
            raise ScenarioError(
                f"found bus and {key}; expected no {key}, because the bus determines it",
                f"{place}.{key}",
            )
    source = parts.endpoint(spec.source, "output", f"{place}.from")
    target = parts.endpoint(spec.target, "input", f"{place}.to")
    name = spec.channel or spec.name or f"{source.name}->{target.name}"
    if spec.frame is None and name not in frames:
        raise ScenarioError("found bus without frame, expected frame = { id = ... }", place)
    period = parts.steps[source.component].period * round(parts.h * 1e12)
    ends = source.component, target.component
    known = frames.get(name)
    if spec.frame is not None:
        offset = parts.scenario.seconds(spec.frame.offset, "links", "frame", "offset")
        offset += late.get(source.component, 0.0)
        fast = buses[spec.bus].data_bitrate is not None
        try:
            made = frame_on_bus(spec.frame, fast, name, ends, period, offset)
        except CosimError as error:
            raise ScenarioError(str(error), f"{place}.frame") from None
        if known and replace(made, receivers=known.receivers, sources=known.sources) != known:
            raise ScenarioError(f"found a second frame of channel {name}, expected one", place)
        known = known or made
    assert known is not None
    if known.sender != source.component:
        raise ScenarioError(f"found a second sender of channel {name}, expected one", place)
    receivers = tuple(dict.fromkeys((*known.receivers, target.component)))
    sources = tuple(dict.fromkeys((*known.sources, source)))
    frames[name] = replace(known, receivers=receivers, sources=sources)
    return name, target.component


def _table(
    parts: ScenarioComponents,
    spec: LinkSpec,
    name: str,
    periods: tuple[int, int],
    place: str,
    given: _TableSources,
) -> TableSpec:
    """The table of a link between a sender and a receiver with these periods, ticks."""
    from cosim.links.semantics import Grid
    from cosim.links.spec import bus_table, link_table

    if not spec.bus and (spec.delay is None or spec.frame is not None):
        raise ScenarioError("expected either delay, or bus and frame", place)
    try:
        grid = Grid(*periods, parts.h)
        if spec.bus:
            return bus_table(given.simulated[place], spec, name, grid)
        key, seed = spec.channel or name, parts.scenario.run.seed
        return link_table(spec, key, seed, grid, given.folder, parts.ticks, given.known)
    except CosimError as error:
        raise ScenarioError(str(error), place) from None


def _link(parts: ScenarioComponents, spec: LinkSpec, place: str, given: _TableSources) -> Link:
    source = parts.endpoint(spec.source, "output", f"{place}.from")
    target = parts.endpoint(spec.target, "input", f"{place}.to")
    gain, offset = fit(parts, source, target, place)
    name = spec.name or f"{source.name}->{target.name}"
    periods = parts.steps[source.component].period, parts.steps[target.component].period
    late = _later(spec, given.late.get(source.component, 0.0), place)
    table = _table(parts, late, name, periods, place, given)
    initial = None
    if spec.initial is not None:
        initial = numbers(spec.initial, target.shape, target.unit, f"{place}.initial")
    return Link(
        name, source, target, table, gain, offset, initial, _age(parts, spec, target, place)
    )


def _age(parts: ScenarioComponents, spec: LinkSpec, target: Slot, place: str) -> Slot | None:
    if not spec.age:
        return None
    age = parts.scalar_input(spec.age, f"{place}.age")
    if age.component != target.component:
        raise ScenarioError(
            f"{age.name} receives the age of {target.name}; expected an input of "
            f"{target.component}",
            f"{place}.age",
        )
    return age
