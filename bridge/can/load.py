"""Load of a CAN bus: planned from its messages, or measured from a log."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bridge.native.frame import Flags
from cosim.bus.stuffing import BYTE, CRC15, DUE, SEVEN
from cosim.bus.timing import (
    FD_TAIL,
    TAIL,
    Bits,
    BusTiming,
    FrameFormat,
    TimingError,
    best,
    mean,
    padded,
    start,
    worst,
)

IntArray = NDArray[np.int64]
_RELEVANT = Flags.FD | Flags.BRS | Flags.ESI | Flags.REMOTE | Flags.EXTENDED | Flags.ERROR
_BYTE = np.array(BYTE, dtype=np.int32)
_SEVEN = np.array(SEVEN, dtype=np.int32)
_CRC15 = np.array(CRC15, dtype=np.int32)
_IS_DUE = np.isin(np.arange(16), DUE).astype(np.int32)


class Share(NamedTuple):
    """Fractions of time in which a bus is busy (0 to 1), for the best, random and worst payload."""

    best: float
    mean: float
    worst: float


def planned_load(frames: Iterable[tuple[int, FrameFormat, float]], timing: BusTiming) -> Share:
    """Load of periodic frames: (length in bytes, kind, period in s) each."""
    total = [0.0, 0.0, 0.0]
    for length, kind, period in frames:
        for i, law in enumerate((best, mean, worst)):
            total[i] += seconds(law(length, kind), timing) / period
    return Share(*total)


def seconds(bits: Bits, timing: BusTiming) -> float:
    """The time that so many bits take, s."""
    data_rate = timing.data_bitrate or timing.bitrate
    return bits.nominal / timing.bitrate + bits.data / data_rate


def log_bits(
    identifiers: NDArray[np.uint32],
    flags: NDArray[np.uint8],
    lengths: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> IntArray:
    """Exact bit times of the frames of a log, (N, 2): nominal, data.

    Args:
        identifiers: (N,) without flag bits.
        flags: (N,) as in ``bridge/c/frame.h``.
        lengths: (N,) bytes; of a remote frame: what it asks for.
        data: (N, width), what is beyond a frame's length is ignored.

    Error frames take (0, 0). Raises TimingError where a frame cannot be one.
    """
    relevant = np.asarray(flags, np.int64) & int(_RELEVANT)
    keys = np.asarray(identifiers, np.int64) << 16 | relevant << 8 | np.minimum(lengths, 255)
    headers, which = np.unique(keys, return_inverse=True)
    begun = np.array([_start(int(key)) for key in headers], np.int32).reshape(-1, 6)[which]
    nominal, late, state, crc, length, phases = begun.T
    stuffed, crc, state = _stuffed(state, crc, np.where(phases < 0, 0, length), lengths, data)
    classic = np.flatnonzero((phases == 0) | (phases == -1))
    stuffed[classic] += _crc_stuffed(state[classic], crc[classic])
    body = np.where(phases > 0, 8 * length + np.where(length <= 16, 27, 32) + 1, 8 * length + 15)
    body = np.where(phases < 0, 15, body) + late + stuffed
    bits = np.stack([nominal + body + TAIL, np.zeros_like(body)], axis=1).astype(np.int64)
    bits[phases == 1, 0] += FD_TAIL - TAIL
    switched = phases == 2
    bits[switched] = np.stack([nominal[switched] + FD_TAIL, body[switched]], axis=1)
    bits[phases == -2] = 0
    return bits


def _start(key: int) -> tuple[int, int, int, int, int, int]:
    """The `Start` of a header, its length on the bus, and phases.

    Phases: -2 error frame, -1 remote, 0 classic, 1 FD without, 2 FD with BRS.
    """
    flags, length = Flags(key >> 8 & 0xFF), key & 0xFF
    if flags & Flags.ERROR:
        return (0, 0, 0, 0, 0, -2)
    kind = kind_of(flags)
    on_bus = padded(length, kind.fd)
    phases = (2 if kind.brs else 1) if kind.fd else -1 if kind.remote else 0
    return (*start(key >> 16, on_bus, kind), on_bus, phases)


def kind_of(flags: int) -> FrameFormat:
    """The kind of a frame with these flags; BRS and ESI count in FD frames only."""
    fd = bool(flags & Flags.FD)
    return FrameFormat(
        extended=bool(flags & Flags.EXTENDED),
        fd=fd,
        brs=fd and bool(flags & Flags.BRS),
        esi=fd and bool(flags & Flags.ESI),
        remote=bool(flags & Flags.REMOTE),
    )


def _stuffed(
    state: NDArray[np.int32],
    crc: NDArray[np.int32],
    on_bus: NDArray[np.int32],
    lengths: NDArray[np.uint16],
    data: NDArray[np.uint8],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """(stuff bits, CRC, state) after the data of all frames, a byte of all at a time."""
    order = np.argsort(-on_bus, kind="stable")
    at, sums, left = state[order] << 8, np.zeros(len(order), np.int32), crc[order]
    sorted_lengths, own = on_bus[order], np.asarray(lengths)[order]
    for j in range(int(on_bus.max(initial=0))):
        n = int(np.searchsorted(-sorted_lengths, -j, side="left"))
        byte = np.zeros(n, np.int32)
        if j < data.shape[1]:
            byte = np.where(own[:n] > j, data[order[:n], j], 0).astype(np.int32)
        entry = _BYTE[at[:n] | byte]
        at[:n] = entry & 0xF00
        sums[:n] += entry >> 12
        if j < 8:
            left[:n] = _CRC15[left[:n] >> 7 ^ byte] ^ (left[:n] << 8 & 0x7FFF)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return sums[back], left[back], (at >> 8)[back]


def _crc_stuffed(state: NDArray[np.int32], crc: NDArray[np.int32]) -> NDArray[np.int32]:
    """Stuff bits in, and behind, the CRC of classic frames."""
    entry = _BYTE[state << 8 | crc >> 7]
    last = _SEVEN[(entry & 0xF00) >> 1 | crc & 0x7F]
    result: NDArray[np.int32] = (entry >> 12) + (last >> 11) + _IS_DUE[last >> 7 & 15]
    return result


def log_times(bits: IntArray, timing: BusTiming) -> IntArray:
    """The time that frames take, (N,) ns, to the nearest. `bits`: (N, 2)."""
    data_rate = timing.data_bitrate or timing.bitrate
    ns = bits[:, 0] * 1e9 / timing.bitrate + bits[:, 1] * 1e9 / data_rate + 0.5
    return ns.astype(np.int64)


@dataclass(frozen=True, slots=True)
class Measured:
    """Load of a log, 1 = always busy. Above 1: more than the bus can carry, so it did not.

    `mean` from the first start to the last end; `peak` of any `window_ns`, begun at `peak_ns`;
    `windows`, (n,): of one window after the other, the last one may be cut short.
    """

    mean: float
    peak: float
    peak_ns: int
    window_ns: int
    windows: NDArray[np.float64]

    @property
    def possible(self) -> bool:
        """True if one bus of these bit rates can have carried the log (2 % for its clock)."""
        return self.peak <= 1.02


def measured_load(ends: IntArray, durations: IntArray, window_ns: int = 100_000_000) -> Measured:
    """Load of frames that end at `ends` and took `durations`, (N,) ns each; in any order.

    Raises TimingError for a window that is not positive or a log without frames.
    """
    if window_ns <= 0 or len(ends) == 0:
        raise TimingError(
            f"found {len(ends)} frames and a window of {window_ns} ns, expected more than 0 of each"
        )
    ends = np.asarray(ends, np.int64)
    starts = ends - durations
    busy = _Busy(starts, ends)
    first, last = int(starts.min()), int(ends.max())
    edges = np.append(np.arange(first, last, window_ns, dtype=np.int64), last)
    windows = np.diff(busy(edges)) / np.diff(edges)
    begins = np.concatenate([starts, ends - window_ns])
    each = busy(begins + window_ns) - busy(begins)
    most = int(np.argmax(each))
    mean_load = float(durations.sum() / (last - first))
    return Measured(mean_load, float(each[most] / window_ns), int(begins[most]), window_ns, windows)


def durations(rows: NDArray[np.void], timing: BusTiming) -> IntArray:
    """The time that the frames of a log (``bridge.native.frame.frame_dtype``), (N,), took, (N,) ns.

    Error frames count as no time. Raises TimingError where a frame cannot be one.
    """
    bits = log_bits(rows["id"], rows["flags"], rows["length"], rows["data"])
    return log_times(bits, timing)


class _Busy:
    """The time that the bus was busy up to a time, ns: exact, integers."""

    def __init__(self, starts: IntArray, ends: IntArray) -> None:
        self.edges = [np.sort(starts), np.sort(ends)]
        self.sums = [np.concatenate([[0], np.cumsum(e - starts.min())]) for e in self.edges]
        self.origin = int(starts.min())

    def __call__(self, t: IntArray) -> IntArray:
        gone = []
        for edges, sums in zip(self.edges, self.sums, strict=True):
            n = np.searchsorted(edges, t, side="right")
            gone.append(n * (t - self.origin) - sums[n])
        result: IntArray = gone[0] - gone[1]
        return result
