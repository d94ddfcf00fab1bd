"""Other traffic and errors of a scenario's simulated bus, as sources and disturbances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cosim.base.errors import ScenarioError
from cosim.base.names import unknown
from cosim.bus.candump import read_candump
from cosim.bus.dbc_traffic import dbc_sources, read_messages, senders
from cosim.bus.frames import BusFrame
from cosim.bus.settings import (
    Disturbance,
    ErrorRate,
    Interruption,
    LineLevel,
    ScriptedError,
)
from cosim.bus.timing import BusTiming, FrameFormat
from cosim.bus.traffic import (
    LogSource,
    PeriodicSource,
    TrafficSource,
    babbling,
    random_load,
    refuse_fd,
)
from cosim.scenario.bus_frames import bus_time
from cosim.scenario.bus_spec import (
    BabblingTraffic,
    DbcTraffic,
    InterruptionErrors,
    LogTraffic,
    PeriodicTraffic,
    RandomTraffic,
    RateErrors,
    ScriptErrors,
)
from cosim.scenario.spec import Scenario


def traffic(
    scenario: Scenario, bus: str, timing: BusTiming, names: Sequence[str]
) -> tuple[list[TrafficSource], list[str]]:
    """(the sources of [[bus.NAME.traffic]], all nodes of the bus: `names`, and theirs behind).

    Raises ScenarioError, also for the settings of a node that is none of them, or TrafficError.
    """
    nodes = list(names)
    sources: list[TrafficSource] = []

    def node(name: str) -> int:
        if name not in nodes:
            nodes.append(name)
        return nodes.index(name)

    for i, t in enumerate(scenario.buses[bus].traffic):
        seed = scenario.run.seed + 1000 + i
        if isinstance(t, DbcTraffic):
            messages = read_messages(path := scenario.path.parent / t.file)
            refuse_fd(path, any(m.format.fd for m in messages), timing)
            numbers = {name: node(name) for name in senders(messages)}
            sources += dbc_sources(messages, numbers, t.jitter, seed)
        elif isinstance(t, RandomTraffic):
            sources.append(random_load(t.share, [node(t.node)], timing, seed))
        elif isinstance(t, LogTraffic):
            start = _ps(scenario, t.start, bus, "start")
            path = scenario.path.parent / t.file
            sources.append(log_source(path, node(t.node), timing, start))
        else:
            sources.append(_periodic(scenario, bus, t, node(t.node), timing, seed))
    for name in scenario.buses[bus].nodes:
        if name not in nodes:
            raise ScenarioError(unknown(name, nodes, "node of the bus"))
    return sources, nodes


def _periodic(
    scenario: Scenario,
    bus: str,
    t: PeriodicTraffic | BabblingTraffic,
    node: int,
    timing: BusTiming,
    seed: int,
) -> PeriodicSource:
    start = _ps(scenario, t.start, bus, "start")
    stop = None if t.stop is None else _ps(scenario, t.stop, bus, "stop")
    if stop is not None and stop <= start:
        raise ScenarioError(f"found start = {t.start} and stop = {t.stop}, expected stop behind")
    if isinstance(t, BabblingTraffic):
        return babbling(node, BusFrame(t.id, bytes(8)), timing, start, stop, t.share)
    return PeriodicSource(
        node,
        BusFrame(t.id, bytes(t.bytes), FrameFormat(extended=t.extended)),
        _ps(scenario, t.period, bus, "period"),
        offset_ps=_ps(scenario, t.offset, bus, "offset"),
        jitter_ps=_ps(scenario, t.jitter, bus, "jitter"),
        seed=seed,
        start_ps=start,
        end_ps=stop,
        random_data=True,
    )


def log_source(path: Path, node: int, timing: BusTiming, start_ps: int) -> LogSource:
    """The frames of a candump log, the first received at `start_ps` or as soon as possible.

    Raises TrafficError for a file that is not such a log, or for CAN FD frames on a classic bus.
    """
    times, frames = read_candump(path)
    refuse_fd(path, bool((frames["flags"] & 1).any()), timing)
    return LogSource(node, times + start_ps, frames, timing)


def disturbances(scenario: Scenario, bus: str, number: Mapping[str, int]) -> list[Disturbance]:
    """The disturbances of [[bus.NAME.errors]]. Raises ScenarioError for an unknown node."""
    found: list[Disturbance] = []
    for e in scenario.buses[bus].errors:
        if e.node and e.node not in number:
            raise ScenarioError(f"found node {e.node!r}, expected one of {', '.join(number)}")
        node = number[e.node] if e.node else None
        match e:
            case RateErrors():
                found.append(ErrorRate(e.rate, e.length, node))
            case ScriptErrors():
                found.append(ScriptedError(e.id, e.bit, e.attempt, e.length, e.extended, node))
            case InterruptionErrors():
                level = LineLevel[e.level.upper()]
                start = _ps(scenario, e.start, bus, "start")
                found.append(Interruption(start, _ps(scenario, e.stop, bus, "stop"), level, node))
    return found


def _ps(scenario: Scenario, value: int | float | str, bus: str, key: str) -> int:
    return bus_time(scenario.seconds(value, "bus", bus), key)
