"""Traffic for a simulated bus: periodic messages with jitter, a babbling node, random frames, logs.

A source gives requests in the order of time; :func:`merged` puts those of several together:

    sources = [
        PeriodicSource(0, BusFrame(0x123, bytes(8)), period_ps=10 * 10**9, jitter_ps=10**8, seed=1),
        babbling(1, BusFrame(0x001, bytes(8)), timing, 50 * 10**9, 60 * 10**9),
    ]
    bus.request_many(merged(sources, 0, 10**12))

Sources have no state: the same times give the same requests, however they are cut into calls, so
that a run can be repeated exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import CosimError
from cosim.bus.described import bit_ps
from cosim.bus.frames import FRAME, REQUEST, BusFrame, frame_of
from cosim.bus.timing import CLASSIC, BusTiming, FrameFormat, frame_bits, mean, padded

#: The number of random frames is drawn for blocks of so much time, ps,
BLOCK_PS = 10**11
#: and a block has fewer than 2 to the power of this.
_BLOCK_BITS = 24
#: Times of traffic are at most 50 days, ps, so that sums of them fit into 64 bits.
LONGEST_PS = 50 * 86400 * 10**12


class TrafficError(CosimError, ValueError):
    """Traffic that cannot be."""


class TrafficSource(Protocol):
    """A source of requests."""

    def requests(self, start_ps: int, end_ps: int) -> NDArray[np.void]:
        """Requests from `start_ps` to before `end_ps` (ps), by time: (n,), rows of ``REQUEST``."""


def merged(sources: Sequence[TrafficSource], start_ps: int, end_ps: int) -> NDArray[np.void]:
    """Requests of all sources from `start_ps` to before `end_ps` (ps), by time: (n,).

    The rows are of ``REQUEST``. Requests of one time keep the order of their sources.
    """
    parts = [source.requests(start_ps, end_ps) for source in sources]
    rows = np.concatenate(parts) if parts else np.zeros(0, REQUEST)
    return rows.take(np.argsort(rows["at"], kind="stable"))


@final
@dataclass(frozen=True, slots=True)
class PeriodicSource:
    """A frame every `period_ps` from `offset_ps` on, each late by up to `jitter_ps` at random.

    `start_ps`, `end_ps`: events before and from there on are left out (None: no end). Late requests
    are uniformly distributed and keep their order: one that would be before its predecessor is made
    with it. `random_data`: new random bytes each time, instead of those of `frame`. Times in ps.
    """

    node: int
    frame: BusFrame
    period_ps: int
    offset_ps: int = 0
    jitter_ps: int = 0
    seed: int = 0
    start_ps: int = 0
    end_ps: int | None = None
    random_data: bool = False

    def __post_init__(self) -> None:
        times = self.period_ps, self.offset_ps, self.jitter_ps
        if self.period_ps <= 0 or min(times) < 0 or max(times) > LONGEST_PS:
            period, offset, jitter = (f"{t / 1e12:.6g} s" for t in times)
            raise TrafficError(
                f"identifier {self.frame.identifier:#x}: found a period of {period}, an offset of"
                f" {offset} and a jitter of {jitter}, expected a period above 0, the others not"
                " below 0, and none above 50 days"
            )

    def requests(self, start_ps: int, end_ps: int) -> NDArray[np.void]:
        """Requests from `start_ps` to before `end_ps` (ps), by time: (n,), rows of ``REQUEST``."""
        # events before `start_ps`, too: a late one delays those behind it
        low = max(start_ps - 2 * self.jitter_ps, self.start_ps) - self.offset_ps
        high = end_ps if self.end_ps is None else min(end_ps, self.end_ps)
        first = max(0, -(-low // self.period_ps))
        last = max(first, -(-(high - self.offset_ps) // self.period_ps))
        numbers = np.arange(first, last, dtype=np.int64)
        at = self.offset_ps + numbers * self.period_ps
        if self.jitter_ps:
            late = _draws(self.seed, numbers, 0) % np.uint64(self.jitter_ps + 1)
            at = np.maximum.accumulate(at + late.astype(np.int64)) if len(at) else at
        kept = (at >= start_ps) & (at < end_ps)
        rows = np.zeros(int(kept.sum()), REQUEST)
        rows["at"], rows["node"], rows["frame"] = at[kept], self.node, self.frame.row()
        if self.random_data and not self.frame.format.remote:
            _fill(rows, self.seed, numbers[kept])
        return rows


def babbling(
    node: int,
    frame: BusFrame,
    timing: BusTiming,
    start_ps: int = 0,
    end_ps: int | None = None,
    share: float = 1.0,
) -> PeriodicSource:
    """A babbling node: it requests `share` of the bus with one frame, from `start_ps` to `end_ps`.

    With `share` 1 it makes a request whenever the last frame can have ended; with a dominant
    identifier no other node sends then. Requests beyond its transmit queue are dropped.

    Raises:
        TrafficError: `share` is not positive.
    """
    if not share > 0:
        raise TrafficError(f"found a share of {share}, expected more than 0")
    bits = frame_bits(frame.identifier, frame.data, frame.format, frame.dlc)
    length = int(bits.nominal) * bit_ps(timing.bitrate)
    length += int(bits.data) * bit_ps(timing.data_bitrate or timing.bitrate)
    period = max(1, round(length / share))
    return PeriodicSource(node, frame, period, offset_ps=start_ps, start_ps=start_ps, end_ps=end_ps)


@final
@dataclass(frozen=True, slots=True)
class RandomSource:
    """Frames at random (Poisson) times: on average `rate` in a second, from `nodes` in turn.

    `identifiers`: from which each is drawn, node by node disjoint so that no two nodes share one:
    an identifier belongs to node ``nodes[index % len(nodes)]``. `lengths`: bytes, from which each
    is drawn; the data is random.
    """

    nodes: tuple[int, ...]
    rate: float
    identifiers: tuple[int, ...] = tuple(range(0x100, 0x700, 0x10))
    lengths: tuple[int, ...] = (8,)
    format: FrameFormat = CLASSIC
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.rate > 0 or not self.nodes or len(self.identifiers) < len(self.nodes):
            raise TrafficError(
                f"found a rate of {self.rate} frames/s, {len(self.nodes)} nodes and"
                f" {len(self.identifiers)} identifiers, expected a rate above 0, a node, and an"
                " identifier for each node"
            )

    def requests(self, start_ps: int, end_ps: int) -> NDArray[np.void]:
        """Requests from `start_ps` to before `end_ps` (ps), by time: (n,), rows of ``REQUEST``."""
        numbers = self._numbers(start_ps // BLOCK_PS, -(-end_ps // BLOCK_PS))
        late = _draws(self.seed, numbers, 1) % np.uint64(BLOCK_PS)
        at = np.sort((numbers >> _BLOCK_BITS) * BLOCK_PS + late.astype(np.int64))
        kept = slice(*np.searchsorted(at, [start_ps, end_ps]))
        at, numbers = at[kept], numbers[kept]
        rows = np.zeros(len(at), REQUEST)
        rows["at"], frames = at, rows["frame"]
        which = _draws(self.seed, numbers, 2) % np.uint64(len(self.identifiers))
        rows["node"] = np.array(self.nodes)[which % np.uint64(len(self.nodes))]
        frames["id"], frames["flags"] = np.array(self.identifiers)[which], _flags(self.format)
        sizes = np.array([padded(n, self.format.fd) for n in self.lengths])
        frames["length"] = sizes[_draws(self.seed, numbers, 3) % np.uint64(len(sizes))]
        width = int(sizes.max())
        data = _random_bytes(self.seed, numbers, width, 4)
        if sizes.min() < width:
            data = np.where(np.arange(width) < frames["length"][:, None], data, 0)
        frames["data"][:, :width] = data
        return rows

    def _numbers(self, first: int, last: int) -> NDArray[np.int64]:
        """Numbers of the requests of blocks `first` to before `last`: block * 2^24 + 0, 1, ...

        The number of requests in a block is Poisson distributed, by a separate draw.
        """
        blocks = np.arange(first, max(first, last), dtype=np.int64)
        mean_count = self.rate * BLOCK_PS / 1e12
        most = int(mean_count + 12 * mean_count**0.5 + 12)
        steps = np.log(mean_count) - np.log(np.arange(1, most + 1))
        below = np.cumsum(np.exp(np.concatenate([[0.0], np.cumsum(steps)]) - mean_count))
        drawn = (_draws(self.seed, blocks, 0) >> np.uint64(11)).astype(np.float64) * 2.0**-53
        counts = np.searchsorted(below, drawn, side="right")
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        numbers: NDArray[np.int64] = (np.repeat(blocks, counts) << _BLOCK_BITS) + within
        return numbers


def random_load(
    share: float, nodes: Sequence[int], timing: BusTiming, seed: int = 0
) -> RandomSource:
    """Random frames of 8 bytes that take `share` (0 to 1) of the bus on average.

    Raises:
        TrafficError: `share` is not between 0 and 1.
    """
    if not 0 < share < 1:
        raise TrafficError(f"found a load of {share:.0%}, expected more than 0 and less than 100 %")
    rate = share * timing.bitrate / mean(8).nominal
    return RandomSource(tuple(nodes), rate, seed=seed)


@final
class LogSource:
    """Traffic from a recorded log: the frames in their order, at their recorded times.

    `times_ps`, shape (n,), in ps and ascending: the time at which each frame was received, i.e. the
    end of its last bit; its request is earlier, so that it ends at that time if the bus is free.
    `frames`: rows of ``FRAME``, shape (n,). Raises TrafficError for times that decrease.
    """

    def __init__(
        self, node: int, times_ps: NDArray[np.int64], frames: NDArray[np.void], timing: BusTiming
    ) -> None:
        if len(times_ps) != len(frames) or (np.diff(times_ps) < 0).any():
            raise TrafficError(
                "found log times that go back, expected one for each frame, in order"
            )
        lengths = np.array([_received_after(row, timing) for row in frames], np.int64)
        self._rows = np.zeros(len(frames), REQUEST)
        starts = np.maximum(np.asarray(times_ps, np.int64) - lengths, 0)
        self._rows["at"] = np.maximum.accumulate(starts) if len(starts) else starts
        self._rows["node"], self._rows["frame"] = node, frames.astype(FRAME)

    def requests(self, start_ps: int, end_ps: int) -> NDArray[np.void]:
        """Requests from `start_ps` to before `end_ps` (ps), by time: (n,), rows of ``REQUEST``."""
        low, high = np.searchsorted(self._rows["at"], [start_ps, end_ps])
        return self._rows[low:high].copy()


def refuse_fd(where: object, fd: bool, timing: BusTiming) -> None:
    """Raises TrafficError if there are CAN FD frames (`fd`) for a classic bus."""
    if fd and not timing.fd:
        raise TrafficError(f"{where}: found CAN FD frames on a classic bus, expected one with fd")


def _received_after(row: np.void, timing: BusTiming) -> int:
    """The time from the start of frame to the end of its last bit, ps."""
    frame = frame_of(row)
    bits = frame_bits(frame.identifier, frame.data, frame.format, frame.dlc)
    data = int(bits.data) * bit_ps(timing.data_bitrate or timing.bitrate)
    return (int(bits.nominal) - 3) * bit_ps(timing.bitrate) + data


def _flags(kind: FrameFormat) -> int:
    return BusFrame(0, format=kind).flags


def _draws(seed: int, numbers: NDArray[np.int64], column: int) -> NDArray[np.uint64]:
    """A random number of 64 bits for each event, from its number alone (splitmix64, S. Vigna)."""
    key = (seed * 0x9E3779B97F4A7C15 + column * 0xD1B54A32D192ED03) & (1 << 64) - 1
    with np.errstate(over="ignore"):
        z = np.uint64(key) + (numbers.astype(np.uint64) + np.uint64(1)) * np.uint64(
            0x9E3779B97F4A7C15
        )
        z = (z ^ z >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ z >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
        return z ^ z >> np.uint64(31)


def _fill(rows: NDArray[np.void], seed: int, numbers: NDArray[np.int64]) -> None:
    """Random data of the length that the frames have."""
    if not len(rows):
        return
    length = int(rows["frame"]["length"][0])
    rows["frame"]["data"][:, :length] = _random_bytes(seed, numbers, length, 1)


def _random_bytes(
    seed: int, numbers: NDArray[np.int64], width: int, column: int
) -> NDArray[np.uint8]:
    """Random bytes for each event, (n, width), from the draws of `column` and those behind it."""
    words = [_draws(seed, numbers, column + i) for i in range(-(-width // 8))]
    if not words:
        return np.zeros((len(numbers), 0), np.uint8)
    data = np.stack(words, axis=1).astype("<u8").view(np.uint8)
    return data.reshape(len(numbers), 8 * len(words))[:, :width]
