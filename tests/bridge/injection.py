"""Frames put through rules, looked at every millisecond."""

from __future__ import annotations

from bridge.native.faults import FOREVER, Fault
from bridge.native.frame import Frame

START = 10**12  # of the run, on the clock of the frames
MS = 1_000_000


def rule(kind, **more):
    said = {"count": 1, "t0_ns": 0, "t1_ns": FOREVER, "bus": -1, "probability": 1.0, "random": 7}
    return Fault(kind=kind, **{**said, **more})


def frame(n, t=None, identifier=0x100, length=8, bus=0, flags=0):
    """Frame number n; it arrives n ms after the start."""
    data = bytes((n * 31 + k) % 256 for k in range(length))
    made = Frame.of(identifier, data, flags, START + (n * MS if t is None else t))
    made.sequence, made.bus = n, bus
    return made


def through(injector, frames, until=10**11):
    """Everything that gets through, looked at every millisecond: (ms, number, payload)."""
    out, coming = [], list(frames)
    for now in range(START, START + until, MS):
        while coming and coming[0].t_ns <= now:
            injector.put(coming.pop(0), START)
        while (got := injector.get(now)) is not None:
            assert got.reserved == 0
            assert now - MS < got.t_ns <= now
            out.append(((got.t_ns - START) / MS, got.sequence, got.payload))
        if not coming and injector.struct.n_waiting == 0:
            return out
    raise AssertionError("frames still wait")


def numbers(out):
    return [n for _, n, _ in out]


def flipped(a, b):
    return sum((x ^ y).bit_count() for x, y in zip(a, b, strict=True))
