"""Traffic on a simulated channel: a DBC file, a recorded log, or a share of the bus."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import final

import numpy as np

from bridge.can.log import read_log
from bridge.native.frame import Flags
from bridge.simulated_can.channel import Channel
from bridge.simulated_can.node import WireNode
from cosim.bus.dbc_traffic import dbc_sources, read_messages, senders
from cosim.bus.frames import FRAME, frame_of
from cosim.bus.timing import BusTiming
from cosim.bus.traffic import LogSource, TrafficError, TrafficSource, merged, random_load, refuse_fd

BLOCK_PS = 10**11
"""Requests are made for so much time at once, ps."""
_RANDOM_NODES = 4


def load_sources(
    text: str, timing: BusTiming, jitter: float = 0.0, seed: int = 0
) -> tuple[list[TrafficSource], tuple[str, ...]]:
    """The traffic that `text` names, and the names of its nodes, which are numbered from 0.

    `text`: a DBC file (``.dbc``; messages with a period, `jitter` as a share of it), a log
    (``.log``, ``.asc``, ``.blf``), or a share of the bus such as ``30%``. Raises TrafficError,
    LogError.
    """
    if text.endswith("%"):
        try:
            share = float(text[:-1]) / 100
        except ValueError as error:
            raise TrafficError(f"--load {text}: expected a number before the %") from error
        names = tuple(f"load {i + 1}" for i in range(_RANDOM_NODES))
        return [random_load(share, range(_RANDOM_NODES), timing, seed)], names
    path = Path(text)
    if path.suffix == ".dbc":
        messages = read_messages(path)
        names = senders(messages)
        numbers = {name: i for i, name in enumerate(names)}
        found = dbc_sources(messages, numbers, jitter, seed)
        refuse_fd(path, any(m.format.fd for m in messages), timing)
        return list(found), names
    return [_log_source(path, timing)], (path.name,)


def _log_source(path: Path, timing: BusTiming) -> LogSource:
    """The frames of a log, from its first one on; error frames are left out."""
    if not path.is_file():
        raise TrafficError(
            f"--load {path}: found no such file, expected a .dbc file, a log, or a share like 30%"
        )
    rows = read_log(path).rows
    rows = rows[rows["flags"] & int(Flags.ERROR) == 0]
    rows = rows[np.argsort(rows["t_ns"], kind="stable")]
    if not len(rows):
        raise TrafficError(f"{path}: found no frames, expected some")
    frames = np.zeros(len(rows), FRAME)
    frames["id"] = rows["id"]
    frames["flags"] = rows["flags"] & 31
    frames["length"] = rows["length"]
    frames["data"] = rows["data"]
    refuse_fd(path, bool((frames["flags"] & 1).any()), timing)
    times = (rows["t_ns"].astype(np.int64) - int(rows["t_ns"][0])) * 1000
    return LogSource(0, times + _LEAD_PS, frames, timing)


_LEAD_PS = 10**9
"""The first frame of a log ends so long after the begin, ps."""


@final
class ChannelLoad:
    """Traffic as nodes of a channel: in the channel's time, from its time 0 on."""

    def __init__(
        self, channel: Channel, sources: Sequence[TrafficSource], names: Sequence[str]
    ) -> None:
        self._channel, self._sources = channel, sources
        self._nodes: list[WireNode] = [channel.add_node(name) for name in names]
        self._until = channel.now_ps // BLOCK_PS * BLOCK_PS
        channel.schedule(self)

    def fire(self, due_ps: int) -> int | None:
        """Offer the frames of the next stretch of time; returns when that is over, ps."""
        rows = merged(self._sources, max(self._until, due_ps), self._until + BLOCK_PS)
        self._channel.offer(
            (int(row["at"]), self._nodes[int(row["node"])], frame_of(row["frame"])) for row in rows
        )
        self._until += BLOCK_PS
        return self._until
