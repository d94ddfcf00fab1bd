"""``pace.h``: absolute deadlines, and how late one woke. Times are ns of the monotonic clock."""

from __future__ import annotations

import ctypes as c

import numpy as np
from numpy.typing import NDArray

from bridge.native.enums import PACE_BINS
from bridge.native.library import library
from bridge.native.structs import Histogram

__all__ = ["BINS", "Histogram", "add", "counts", "edges", "now", "quantile", "run", "wait"]
BINS = PACE_BINS
_LINEAR, _PER_OCTAVE = 1024, 64
_STEP = _LINEAR // _PER_OCTAVE


def add(histogram: Histogram, ns: int) -> None:
    """Count one value, ns; below 0 it counts in the first bin, beyond 67 s in the last."""
    library().histogram_add(c.byref(histogram), ns)


def quantile(histogram: Histogram, q: float) -> float:
    """Upper edge, ns, of the bin of the ⌈q·count⌉-th smallest; NaN when empty."""
    return float(library().histogram_quantile(c.byref(histogram), q))


def counts(histogram: Histogram) -> NDArray[np.int64]:
    """The bins, (2048,), a copy: 1 us wide to 1024 us, then 64 bins a factor of two."""
    return np.ctypeslib.as_array(histogram.bins).copy()


def edges() -> NDArray[np.int64]:
    """The edges of the bins, ns, (2049,); bin b holds what is in [edges[b], edges[b+1])."""
    bins = np.arange(_PER_OCTAVE * ((BINS - _LINEAR) // _PER_OCTAVE) + 1)
    doubling = (_LINEAR + _STEP * (bins % _PER_OCTAVE)) << (bins // _PER_OCTAVE)
    return 1000 * np.concatenate([np.arange(_LINEAR), doubling]).astype(np.int64)


def now() -> int:
    """The monotonic clock, ns: the same as ``cosim.base.clock.monotonic_ns``."""
    return int(library().pace_now())


def wait(deadline_ns: int, spin_ns: int = 0, stop: c.c_int32 | None = None) -> int:
    """Sleep until a deadline, the last `spin_ns` by polling; return the wake-up time, ns.

    The GIL is released. A nonzero `stop` ends the wait: at its start, while polling, and after a
    signal; a signal alone does not. Python handlers run only after the wait has returned, so `stop`
    must be set by another thread or by C.
    """
    flag = None if stop is None else c.byref(stop)
    return int(library().pace_wait(deadline_ns, spin_ns, flag))


def run(
    start_ns: int, period_ns: int, n: int, spin_ns: int = 0, stop: c.c_int32 | None = None
) -> NDArray[np.int64]:
    """Wait for n deadlines start + k·period; when it woke, ns, (n,), fewer if stopped."""
    woke = np.zeros(n, np.int64)
    flag = None if stop is None else c.byref(stop)
    pointer = woke.ctypes.data_as(c.POINTER(c.c_int64))
    return woke[: library().pace_run(start_ns, period_ns, n, spin_ns, flag, pointer)]
