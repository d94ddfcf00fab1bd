"""Frames of links on a simulated bus of a scenario, and their worst response times by analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cosim.base.errors import ScenarioError
from cosim.bus.arbitration import rank
from cosim.bus.frames import BusFrame
from cosim.bus.response import FrameStream, responses
from cosim.bus.settings import FrameEncoding
from cosim.bus.timing import BusTiming, FrameFormat, padded, worst
from cosim.bus.traffic import LONGEST_PS
from cosim.scenario.bus_spec import LinkFrameSpec, ScenarioBusSpec
from cosim.schedule.parts import Slot

#: Picoseconds in a second.
PS = 10**12


@dataclass(frozen=True, slots=True)
class FrameOnBus:
    """A frame of a scenario's link: its sender, its receivers, a request every `period_ps`.

    With an encoding it carries the values of `sources` (integers: in steps of `scale`); ahead of
    the run it has random data.
    """

    name: str
    sender: str
    receivers: tuple[str, ...]
    frame: BusFrame
    period_ps: int
    offset_ps: int
    random_data: bool
    encoding: FrameEncoding = FrameEncoding.NONE
    scale: float = 1.0
    sources: tuple[Slot, ...] = ()


def bus_time(seconds: float, key: str) -> int:
    """A duration of a scenario in ps, from one in s. Raises ScenarioError below 0, or too long."""
    if not 0 <= seconds <= LONGEST_PS / PS:
        raise ScenarioError(f"found {key} = {seconds:g} s, expected 0 to {LONGEST_PS / PS:g} s")
    return round(seconds * PS)


def frame_on_bus(
    spec: LinkFrameSpec, fast: bool, name: str, ends: tuple[str, str], period_ps: int, offset: float
) -> FrameOnBus:
    """The frame of a link from `ends[0]` to `ends[1]`; `offset` in s.

    Raises TimingError for one that CAN does not have, ScenarioError for an offset below 0.
    """
    kind = FrameFormat(extended=spec.extended, fd=spec.fd, brs=spec.fd and fast)
    frame = BusFrame(spec.id, bytes(padded(spec.bytes, spec.fd)), kind)
    known = spec.data in ("random", "zeros")
    encoding = FrameEncoding.NONE if known else FrameEncoding[spec.data.upper()]
    return FrameOnBus(
        name, ends[0], (ends[1],), frame, period_ps, bus_time(offset, "offset"),
        spec.data != "zeros", encoding, spec.scale,
    )  # fmt: skip


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
