"""Other traffic and errors of a scenario's simulated bus, as sources and disturbances."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cosim.base.errors import ScenarioError
from cosim.bus.dbc_traffic import dbc_sources, read_messages, senders
from cosim.bus.frames import FRAME, BusFrame
from cosim.bus.settings import (
    Disturbance,
    ErrorRate,
    Interruption,
    LineLevel,
    ScriptedError,
)
from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat
from cosim.bus.traffic import (
    LogSource,
    PeriodicSource,
    TrafficSource,
    babbling,
    random_load,
)
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

_LINE = re.compile(r"\((\d+)\.(\d{1,9})\)\s+\S+\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})(##?)(\S*)")


def traffic(
    scenario: Scenario, bus: str, timing: BusTiming, names: Sequence[str]
) -> tuple[list[TrafficSource], list[str]]:
    """(the sources of [[bus.NAME.traffic]], all nodes of the bus: `names`, and theirs behind).

    Raises ScenarioError or TrafficError.
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
            messages = read_messages(scenario.path.parent / t.file)
            numbers = {name: node(name) for name in senders(messages)}
            sources += dbc_sources(messages, numbers, t.jitter, seed)
        elif isinstance(t, RandomTraffic):
            sources.append(random_load(t.share, [node(t.node)], timing, seed))
        elif isinstance(t, LogTraffic):
            start = _ps(scenario, t.start, bus)
            path = scenario.path.parent / t.file
            sources.append(log_source(path, node(t.node), timing, start))
        else:
            sources.append(_periodic(scenario, bus, t, node(t.node), timing, seed))
    return sources, nodes


def _periodic(
    scenario: Scenario,
    bus: str,
    t: PeriodicTraffic | BabblingTraffic,
    node: int,
    timing: BusTiming,
    seed: int,
) -> PeriodicSource:
    start = _ps(scenario, t.start, bus)
    stop = None if t.stop is None else _ps(scenario, t.stop, bus)
    if isinstance(t, BabblingTraffic):
        return babbling(node, BusFrame(t.id, bytes(8)), timing, start, stop, t.share)
    return PeriodicSource(
        node,
        BusFrame(t.id, bytes(t.bytes), FrameFormat(extended=t.extended)),
        _ps(scenario, t.period, bus),
        offset_ps=_ps(scenario, t.offset, bus),
        jitter_ps=_ps(scenario, t.jitter, bus),
        seed=seed,
        start_ps=start,
        end_ps=stop,
        random_data=True,
    )


def log_source(path: Path, node: int, timing: BusTiming, start_ps: int) -> LogSource:
    """The frames of a candump log, the first received at `start_ps` or as soon as it can be.

    Raises ScenarioError for a line that is no frame.
    """
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: {error}; expected a log of candump -l") from error
    times, frames = [], []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        match = _LINE.match(line)
        if match is None:
            raise ScenarioError(f"{path}, line {number}: found {line!r}, expected a CAN frame")
        times.append(int(match[1]) * 10**12 + int(match[2].ljust(12, "0")))
        frames.append(_frame(match[3], match[4] == "##", match[5]).row())
    at = np.array([t - times[0] + start_ps for t in times], np.int64)
    return LogSource(node, at, np.array(frames, FRAME), timing)


def _frame(identifier: str, fd: bool, text: str) -> BusFrame:
    extended = len(identifier) == 8
    if fd:
        kind = FrameFormat(extended=extended, fd=True, brs=bool(int(text[0], 16) & 1))
        return BusFrame(int(identifier, 16), bytes.fromhex(text[1:]), kind)
    kind = FrameFormat(extended=extended, remote=text.startswith("R"))
    if kind.remote:
        return BusFrame(int(identifier, 16), b"", kind, int(text[1:2] or "0"))
    data = bytes.fromhex(text.replace(".", ""))
    return BusFrame(int(identifier, 16), data, kind if extended else CLASSIC)


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
                start, stop = _ps(scenario, e.start, bus), _ps(scenario, e.stop, bus)
                found.append(Interruption(start, stop, level, node))
    return found


def _ps(scenario: Scenario, value: int | float | str, bus: str) -> int:
    return round(scenario.seconds(value, "bus", bus) * 1e12)
