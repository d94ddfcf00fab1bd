"""Worst-case response times of the frames on a scenario's bus, by analysis."""

from __future__ import annotations

from collections.abc import Sequence

from cosim.base.errors import ScenarioError
from cosim.bus.arbitration import rank
from cosim.bus.response import FrameStream, responses
from cosim.bus.timing import BusTiming, worst
from cosim.scenario.bus_frames import FrameOnBus
from cosim.scenario.bus_spec import ScenarioBusSpec


def analysed_bounds(
    spec: ScenarioBusSpec, frames: Sequence[FrameOnBus], timing: BusTiming
) -> dict[str, int | None]:
    """Worst-case response by analysis, ns, up to the end of EOF; empty where it does not apply.

    Raises ScenarioError for two frames with one identifier.
    """
    fifo = any(node.queue != "sorted" or node.one_shot for node in spec.nodes.values())
    streams = []
    for f in frames:
        kind = f.frame.format
        key = rank(f.frame.identifier, kind.extended)
        duration = timing.time_ns(worst(f.frame.length, kind))
        streams.append(FrameStream(f.name, key, f.period_ps // 1000, duration))
    if len({s.rank for s in streams}) < len(streams):
        raise ScenarioError("found one identifier in two frames, expected one for each")
    if fifo or spec.errors or spec.traffic:
        return {}
    ends = {f.name: f.offset_ps // 1000 - 3 * timing.bit_ns for f in frames}
    return {
        r.stream.name: None if r.worst is None else r.worst + ends[r.stream.name]
        for r in responses(streams, timing.bit_ns)
    }
