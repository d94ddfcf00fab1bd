"""Load of messages and of logs: C and NumPy agree with Python."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bridge.can.load import durations, kind_of, log_bits, log_times, measured_load, planned_load
from bridge.native import load as native
from bridge.native.frame import Flags, Frame, frame_dtype
from cosim.bus.arbitration import rank
from cosim.bus.timing import Bits, BusTiming, FrameFormat, TimingError, frame_bits
from tests.cosim.bus.test_timing import frames

MEGABIT = BusTiming(1e6)
FAST = BusTiming(1e6, 5e6, True)
Drawn = tuple[int, bytes, FrameFormat, int]


def flags_of(kind: FrameFormat) -> int:
    names = {"extended": Flags.EXTENDED, "fd": Flags.FD, "brs": Flags.BRS}
    names |= {"remote": Flags.REMOTE, "esi": Flags.ESI}
    return sum(int(flag) for name, flag in names.items() if getattr(kind, name))


def native_frame(drawn: Drawn) -> Frame:
    identifier, data, kind, dlc = drawn
    frame = Frame.of(identifier, data, flags_of(kind))
    frame.length = dlc
    return frame


@given(frames(), st.sampled_from([1e6, 5e5, 125e3, 83333.3]), st.sampled_from([None, 2e6, 8e6]))
def test_c_has_the_bits_and_times_of_python(
    drawn: Drawn, bitrate: float, data_bitrate: float | None
) -> None:
    frame, bits = native_frame(drawn), frame_bits(*drawn)
    timing = BusTiming(bitrate, data_bitrate)
    assert native.frame_bits_exact(frame) == bits
    assert native.frame_time_ns(frame, timing) == timing.time_ns(bits)
    kind = drawn[2]
    assert kind_of(frame.flags) == kind


def test_what_is_no_can_frame_takes_no_time() -> None:
    for frame in (
        Frame.of(1, bytes(9)),
        Frame.of(1, bytes(65), Flags.FD),
        Frame.of(1, b"", Flags.FD | Flags.REMOTE),
        Frame.of(1, b"", Flags.ERROR),
    ):
        assert native.frame_bits_exact(frame) == (0, 0)
        assert native.frame_time_ns(frame, MEGABIT) == 0


@given(st.lists(frames(), min_size=1, max_size=30))
def test_numpy_has_the_bits_of_python(drawn: list[Drawn]) -> None:
    data = np.full((len(drawn), 64), 0xA5, np.uint8)  # what is beyond the length does not count
    for row, (_, payload, _, _) in zip(data, drawn, strict=True):
        row[: len(payload)] = np.frombuffer(payload, np.uint8)
    found = log_bits(
        np.array([d[0] for d in drawn], np.uint32),
        np.array([flags_of(d[2]) | Flags.SENT for d in drawn], np.uint8),
        np.array([d[3] for d in drawn], np.uint16),
        data,
    )
    expected = [frame_bits(*d) for d in drawn]
    assert [Bits(*map(int, row)) for row in found] == expected
    assert log_times(found, FAST).tolist() == [FAST.time_ns(b) for b in expected]


def test_lengths_between_and_error_frames_in_a_log() -> None:
    ids, data = np.array([1, 2], np.uint32), np.full((2, 64), 0xFF, np.uint8)
    flags = np.array([Flags.FD, Flags.ERROR], np.uint8)
    bits = log_bits(ids, flags, np.array([9, 8], np.uint16), data)
    assert bits.tolist() == [[*frame_bits(1, b"\xff" * 9, FrameFormat(fd=True))], [0, 0]]
    assert log_bits(ids[:0], flags[:0], ids[:0].astype(np.uint16), data[:0]).shape == (0, 2)


def test_planned_load_is_the_sum_over_messages() -> None:
    kind = FrameFormat()
    share = planned_load([(8, kind, 1e-3), (8, kind, 1e-3)], MEGABIT)
    assert (share.best, share.worst) == pytest.approx((0.222, 0.27))
    assert share.best < share.mean < share.worst
    # the budget of one FD bus: 4 nodes with 64 bytes at 1 kHz, SYNC and 10 Hz heartbeats
    fd = FrameFormat(fd=True, brs=True)
    all_ = [(64, fd, 1e-3)] * 4 + [(1, kind, 1e-3)] + [(1, kind, 0.1)] * 4
    assert planned_load(all_, FAST).worst == pytest.approx(0.743, abs=0.001)


def slow_busy(starts: list[int], ends: list[int], a: int, b: int) -> int:
    return sum(max(0, min(e, b) - max(s, a)) for s, e in zip(starts, ends, strict=True))


@given(
    st.lists(st.tuples(st.integers(0, 900), st.integers(1, 60)), min_size=1, max_size=20),
    st.integers(1, 300),
)
def test_the_load_of_a_log_is_that_of_its_busiest_window(
    log: list[tuple[int, int]], window: int
) -> None:
    starts, ends = [s for s, _ in log], [s + d for s, d in log]
    found = measured_load(np.array(ends), np.array([d for _, d in log]), window)
    each = {a: slow_busy(starts, ends, a, a + window) for a in range(-window, 1000)}
    assert found.peak == max(each.values()) / window
    assert each[found.peak_ns] == max(each.values())
    first, last = min(starts), max(ends)
    assert found.mean == pytest.approx(sum(d for _, d in log) / (last - first))
    edges = [*range(first, last, window), last]
    tiled = [slow_busy(starts, ends, a, b) / (b - a) for a, b in pairwise(edges)]
    assert found.windows.tolist() == pytest.approx(tiled)


def test_a_log_that_no_bus_can_have_carried_is_noticed() -> None:
    ends = np.arange(1, 1001, dtype=np.int64) * 100_000
    assert measured_load(ends, np.full(1000, 90_000)).possible
    assert not measured_load(ends, np.full(1000, 135_000)).possible
    hour = measured_load(ends + 3_600_000_000_000_000, np.full(1000, 90_000))
    assert hour.peak == pytest.approx(0.9)
    with pytest.raises(TimingError, match="window of 0 ns"):
        measured_load(ends, np.full(1000, 1), 0)
    with pytest.raises(TimingError, match="found 0 frames"):
        measured_load(ends[:0], ends[:0])


def test_rows_of_a_log_have_a_load() -> None:
    rows = np.zeros(100, frame_dtype())
    rows["t_ns"], rows["length"], rows["id"] = np.arange(100) * 1_000_000, 8, 0x123
    rows["data"][:, :8] = 0x55
    busy = frame_bits(0x123, b"\x55" * 8).nominal / 1000
    assert measured_load(rows["t_ns"], durations(rows, MEGABIT), 10_000_000).peak == pytest.approx(
        busy
    )


def test_bits_that_arbitrate() -> None:
    order = [
        rank(0x100), rank(0x100, remote=True), rank(0x100 << 18, True),
        rank(0x100 << 18, True, True), rank((0x100 << 18) + 1, True), rank(0x101),
    ]  # fmt: skip
    assert order == sorted(order)
    assert len(set(order)) == len(order)
