"""``epoch.h``: which run is on the buses, and when its t = 0 was."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from functools import lru_cache

from bridge.native.library import library

#: Values of the message, in this order. `origin`: date of t = 0, us, modulo 2^33 * 10 us.
SIGNALS = ("run", "host", "kept", "origin")
#: What follows where there is room: the identity of the host, 32 bits each.
IDENTITY = ("identity_0", "identity_1", "identity_2", "identity_3")


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
        ("heard", c.c_int32),
        ("identity", c.c_double * 4),
        ("apart_ns", c.c_int64),
        ("dated_ns", c.c_int64),
        ("dated_host", c.c_int64),
    )


def values(
    run: int, host: int, kept: bool, date_ns: int, identity: Sequence[float] = ()
) -> list[float]:
    """Values of the message, for a run whose t = 0 has this date (ns since 1970).

    `identity`: of the host (4,), where the message has room for it.
    """
    return [run, host, float(kept), float(_declared().epoch_origin_us(date_ns)), *identity]


def date_values(host: int, date_ns: int) -> list[float]:
    """Values of the frame DATE before EPOCH on CAN, sent at this date (ns since 1970)."""
    return values(host & 63, 0, False, date_ns)


def new_run(origin_ns: int) -> int:
    """A number for the run with this t = 0."""
    return int(_declared().epoch_run(origin_ns))


@lru_cache(maxsize=1)
def _declared() -> c.CDLL:
    lib = library()
    lib.epoch_run.argtypes, lib.epoch_run.restype = (c.c_int64,), c.c_int32
    lib.epoch_origin_us.argtypes, lib.epoch_origin_us.restype = (c.c_int64,), c.c_int64
    return lib
