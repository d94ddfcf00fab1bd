"""``pace.h``: absolute deadlines, and how late one woke. Times are ns of the monotonic clock."""

from __future__ import annotations

import ctypes as c
from functools import lru_cache
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.native.library import library

BINS = 2048
_LINEAR, _PER_OCTAVE = 1024, 64
_STEP = _LINEAR // _PER_OCTAVE


@final
class Histogram(c.Structure):
    """Counts by lateness (`histogram_t`): 1 us wide to 1024 us, then 64 bins a factor of two."""

    _fields_ = (
        ("count", c.c_int64),
        ("minimum", c.c_int64),
        ("maximum", c.c_int64),
        ("sum", c.c_double),
        ("bins", c.c_int64 * BINS),
    )

    def add(self, ns: int) -> None:
        """Count one value, ns; below 0 it counts in the first bin, beyond 67 s in the last."""
        _declared().histogram_add(c.byref(self), ns)

    def quantile(self, q: float) -> float:
        """Upper edge, ns, of the bin of the ⌈q·count⌉-th smallest; NaN when empty."""
        return float(_declared().histogram_quantile(c.byref(self), q))

    def counts(self) -> NDArray[np.int64]:
        """The bins, (2048,), a copy."""
        return np.ctypeslib.as_array(self.bins).copy()


def edges() -> NDArray[np.int64]:
    """The edges of the bins, ns, (2049,); bin b holds what is in [edges[b], edges[b+1])."""
    bins = np.arange(_PER_OCTAVE * ((BINS - _LINEAR) // _PER_OCTAVE) + 1)
    doubling = (_LINEAR + _STEP * (bins % _PER_OCTAVE)) << (bins // _PER_OCTAVE)
    return 1000 * np.concatenate([np.arange(_LINEAR), doubling]).astype(np.int64)


def now() -> int:
    """The monotonic clock, ns: the same as ``cosim.base.clock.monotonic_ns``."""
    return int(_declared().pace_now())


def wait(deadline_ns: int, spin_ns: int = 0, stop: c.c_int32 | None = None) -> int:
    """Sleep until a deadline, the last `spin_ns` by polling; return the wake-up time, ns.

    The GIL is released. A nonzero `stop` ends the wait: at its start, while polling, and after a
    signal; a signal alone does not. Python handlers run only after the wait has returned, so `stop`
    must be set by another thread or by C.
    """
    flag = None if stop is None else c.byref(stop)
    return int(_declared().pace_wait(deadline_ns, spin_ns, flag))


def run(
    start_ns: int, period_ns: int, n: int, spin_ns: int = 0, stop: c.c_int32 | None = None
) -> NDArray[np.int64]:
    """Wait for n deadlines start + k·period; when it woke, ns, (n,), fewer if stopped."""
    woke = np.zeros(n, np.int64)
    flag = None if stop is None else c.byref(stop)
    pointer = woke.ctypes.data_as(c.POINTER(c.c_int64))
    return woke[: _declared().pace_run(start_ns, period_ns, n, spin_ns, flag, pointer)]


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    flag = c.POINTER(c.c_int32)
    lib.histogram_add.argtypes = (c.POINTER(Histogram), c.c_int64)
    lib.histogram_add.restype = None
    lib.histogram_quantile.argtypes = (c.POINTER(Histogram), c.c_double)
    lib.histogram_quantile.restype = c.c_double
    lib.pace_now.argtypes = ()
    lib.pace_now.restype = c.c_int64
    lib.pace_wait.argtypes = (c.c_int64, c.c_int64, flag)
    lib.pace_wait.restype = c.c_int64
    lib.pace_run.argtypes = (
        c.c_int64, c.c_int64, c.c_int64, c.c_int64, flag, c.POINTER(c.c_int64),
    )  # fmt: skip
    lib.pace_run.restype = c.c_int64
    return lib
