"""``epoch.h``: which run is on the buses, and when its t = 0 was."""

from __future__ import annotations

import ctypes as c

#: Values of the message, in this order. `origin`: date of t = 0, us, modulo :data:`TURN_US`.
SIGNALS = ("run", "host", "kept", "origin")
#: Numbers of runs: 1 to RUNS; 0: a run that was started without EPOCH.
RUNS = 63
TURN_US = 10 * 2**33


class Epoch(c.Structure):
    """``epoch_t``."""

    _fields_ = (
        ("origin_ns", c.c_int64),
        ("heard_ns", c.c_int64),
        ("due_ns", c.c_int64),
        ("run", c.c_int32),
        ("told", c.c_int32),
        ("host", c.c_int32),
        ("kept", c.c_int32),
        ("follows", c.c_int32),
        ("running", c.c_int32),
        ("asked", c.c_int32),
        ("unshared", c.c_int32),
        ("said", c.c_uint32),
        ("reserved", c.c_int32),
    )


def values(run: int, host: int, kept: bool, date_ns: int) -> list[float]:
    """Of the message, for a run whose t = 0 has this date (ns since 1970)."""
    return [run, host, float(kept), (date_ns + 5_000) // 10_000 * 10 % TURN_US]


def new_run(origin_ns: int) -> int:
    """A number for the run with this t = 0."""
    return origin_ns // 1000 % RUNS + 1
