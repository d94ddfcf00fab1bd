"""The simulated CAN buses of a scenario: their links' delays, computed ahead of the run.

A frame is requested when its sender's sample is there, for every sample of the run; other traffic
and errors are those of the scenario. Where nothing on the bus depends on the values that the frames
carry (their data is random bytes from the seed, or zeros), the whole bus is simulated before the
run, and the engine reads one delay for each sample. Otherwise see :mod:`cosim.scenario.bus_ticks`;
what is computed here, with random data, is then an estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.bus.accounting import BusHistory
from cosim.bus.frames import BusEvent
from cosim.bus.settings import AcceptanceFilter, BusNodeSettings, QueueKind
from cosim.bus.simulation import SimulatedBus
from cosim.bus.timing import BusTiming
from cosim.bus.traffic import PeriodicSource
from cosim.links.traces import BusDelays
from cosim.scenario.bus_frames import PS, FrameOnBus, analysed_bounds
from cosim.scenario.bus_spec import ScenarioBusSpec
from cosim.scenario.bus_traffic import disturbances, traffic
from cosim.scenario.spec import Scenario

#: Requests handed to the bus at once.
BLOCK = 4096
#: A filter that no frame passes: an identifier of 30 bits.
NOTHING = AcceptanceFilter(1 << 29, 1 << 29)
#: What waits at the end of the run may still take so long, ps; later it counts as lost.
DRAIN_PS = 10**11


@dataclass(frozen=True, slots=True)
class PreparedBus:
    """A bus, its requests by time, and of each the index of its frame (-1: other traffic)."""

    new: Callable[[], SimulatedBus]
    timing: BusTiming
    names: tuple[str, ...]
    requests: NDArray[np.void]
    owner: NDArray[np.intp]


def simulate_bus(
    scenario: Scenario, name: str, frames: Sequence[FrameOnBus], length_ps: int
) -> dict[tuple[str, str], BusDelays]:
    """The delays of every frame, by (frame, receiver), for a run of `length_ps` (ps).

    Raises ScenarioError with the place of the bus.
    """
    place = scenario.place("bus", name)
    try:
        return _simulate(scenario, name, frames, length_ps)
    except CosimError as error:
        raise ScenarioError(str(error), place) from None


def bus_history(
    scenario: Scenario, name: str, frames: Sequence[FrameOnBus], until_ps: int
) -> BusHistory:
    """All that happens on a bus of a scenario up to `until_ps` (ps), for accounts and pictures.

    Raises ScenarioError with the place of the bus.
    """
    try:
        prepared = prepared_bus(scenario, name, frames, until_ps, tuple(BusEvent))
        events = _run(prepared.new(), prepared.requests, until_ps)
    except CosimError as error:
        raise ScenarioError(str(error), scenario.place("bus", name)) from None
    seen = events[events["time"] <= until_ps]
    return BusHistory(prepared.timing, prepared.names, prepared.requests, seen)


def _simulate(
    scenario: Scenario, name: str, frames: Sequence[FrameOnBus], length_ps: int
) -> dict[tuple[str, str], BusDelays]:
    spec = scenario.buses[name]
    prepared = prepared_bus(
        scenario, name, frames, length_ps, (BusEvent.RECEIVED,), listening(frames)
    )
    bounds = analysed_bounds(spec, frames, prepared.timing)
    events = _run(prepared.new(), prepared.requests, length_ps)
    found = {}
    for i, frame in enumerate(frames):
        mine = np.flatnonzero(prepared.owner == i)
        known = _known(name, spec, frame, bounds.get(frame.name), in_ticks(spec, frames))
        for receiver in frame.receivers:
            node = prepared.names.index(receiver)
            delay = _delays(prepared.requests, mine, events, node, frame)
            found[frame.name, receiver] = BusDelays(delay, _measured(known, delay))
    return found


def prepared_bus(
    scenario: Scenario,
    name: str,
    frames: Sequence[FrameOnBus],
    length_ps: int,
    record: Sequence[BusEvent],
    filters: Mapping[str, tuple[AcceptanceFilter, ...]] | None = None,
) -> PreparedBus:
    """Instructions for the bus at time 0, and all requests up to `length_ps`. Raises CosimError.

    `filters`: what each node receives; a node that is not named receives nothing. None: everything.
    """
    spec, seed = scenario.buses[name], scenario.run.seed
    timing = BusTiming(spec.bitrate, spec.data_bitrate, spec.fd)
    others, names = traffic(scenario, name, timing, _ends(frames))
    number = {node: i for i, node in enumerate(names)}
    parts = [_source(f, number, seed + i).requests(0, length_ps) for i, f in enumerate(frames)]
    owner = [np.full(len(p), i) for i, p in enumerate(parts)]
    parts += [source.requests(0, length_ps) for source in others]
    owner += [np.full(len(p), -1) for p in parts[len(frames) :]]
    rows, whose = np.concatenate(parts), np.concatenate(owner)
    order = np.argsort(rows["at"], kind="stable")
    new = partial(
        SimulatedBus,
        timing,
        [_filtered(node_settings(spec, node), filters) for node in names],
        disturbances=disturbances(scenario, name, number),
        seed=seed,
        record=record,
    )
    return PreparedBus(new, timing, tuple(names), rows.take(order), whose[order])


def _ends(frames: Sequence[FrameOnBus]) -> list[str]:
    return sorted({f.sender for f in frames} | {r for f in frames for r in f.receivers})


def node_settings(spec: ScenarioBusSpec, name: str) -> BusNodeSettings:
    """The settings of a node, which are the default where the scenario has none for it."""
    node = spec.nodes.get(name)
    if node is None:
        return BusNodeSettings(name, inbox=BLOCK)
    queue = QueueKind[node.queue.upper()]
    return BusNodeSettings(
        name, queue, node.length, node.one_shot, recovers=node.recovers, inbox=BLOCK,
        clock_ppm=node.clock_ppm,
    )  # fmt: skip


def in_ticks(spec: ScenarioBusSpec, frames: Sequence[FrameOnBus]) -> bool:
    """True if the run steps the bus inside its ticks: as said, or because frames carry values.

    Raises ScenarioError where frames carry values and the bus is to be simulated ahead of the run.
    """
    carried = [f.name for f in frames if f.encoding]
    if spec.simulated == "ahead" and carried:
        raise ScenarioError(
            f'found simulated = "ahead" and values in the frame {carried[0]}; expected data ='
            ' "random" or "zeros", whose bits are known before the run'
        )
    return bool(carried) or spec.simulated == "in-tick"


def listening(frames: Sequence[FrameOnBus]) -> dict[str, tuple[AcceptanceFilter, ...]]:
    """Acceptance filters of each receiver of a link, for the frames of its links."""
    found: dict[str, tuple[AcceptanceFilter, ...]] = {}
    for f in frames:
        own = AcceptanceFilter(f.frame.identifier, extended=f.frame.format.extended)
        for receiver in f.receivers:
            found[receiver] = (*found.get(receiver, ()), own)
    return found


def _filtered(
    settings: BusNodeSettings, filters: Mapping[str, tuple[AcceptanceFilter, ...]] | None
) -> BusNodeSettings:
    if filters is None:
        return settings
    return replace(settings, filters=filters.get(settings.name, (NOTHING,)))


def _source(f: FrameOnBus, number: Mapping[str, int], seed: int) -> PeriodicSource:
    return PeriodicSource(
        number[f.sender],
        f.frame,
        f.period_ps,
        offset_ps=f.offset_ps,
        seed=seed,
        random_data=f.random_data,
    )


def _run(bus: SimulatedBus, rows: NDArray[np.void], length_ps: int) -> NDArray[np.void]:
    """The events of all requests."""
    events = []
    for first in range(0, len(rows), BLOCK):
        block = rows[first : first + BLOCK]
        bus.request_many(block)
        events.append(bus.advance(int(block["at"][-1])))
    events.append(bus.advance(length_ps + DRAIN_PS))
    return np.concatenate(events)


def _delays(
    rows: NDArray[np.void],
    mine: NDArray[np.intp],
    events: NDArray[np.void],
    node: int,
    frame: FrameOnBus,
) -> NDArray[np.float64]:
    """Delays from each sample to its first reception at `node`, (n,), s."""
    arrived = np.full(len(rows), np.iinfo(np.int64).max)
    heard = events[(events["node"] == node) & (events["request"] >= 0)][::-1]
    arrived[heard["request"]] = heard["time"]  # the first of two receptions is written last
    late = arrived[mine] - rows["at"][mine] + frame.offset_ps
    return np.where(arrived[mine] < np.iinfo(np.int64).max, late / PS, np.inf)


def _known(
    name: str, spec: ScenarioBusSpec, f: FrameOnBus, bound: int | None, in_ticks: bool
) -> dict[str, Any]:
    return {
        "bus": name,
        "identifier": f"{f.frame.identifier:#x}",
        "bytes": f.frame.length,
        "computed": "in the tick" if in_ticks else "ahead of the run",
        "data": f.encoding.name.lower() if f.encoding else "random" if f.random_data else "zeros",
        "bitrate": spec.bitrate,
        "analysed_worst": None if bound is None else bound / 1e9,
    }


def _measured(known: dict[str, Any], delay: NDArray[np.float64]) -> dict[str, Any]:
    there = np.isfinite(delay)
    worst_delay = float(delay[there].max()) if there.any() else None
    lost = int(len(delay) - there.sum())
    return known | {"simulated_worst": worst_delay, "frames": len(delay), "lost": lost}
