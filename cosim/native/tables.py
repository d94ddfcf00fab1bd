"""The rows of links' tables, drawn in C (``tables.h`` is the definition)."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum
from functools import lru_cache

from cosim.native import structs


class RuleCode(IntEnum):
    """``RULE_``: which sample a receiver holds."""

    SIGNAL = 0
    LAST_ARRIVAL = 1
    NEWEST_STAMP = 2
    FIFO = 3
    PLAYOUT = 4


class PcgStruct(c.Structure):
    """``pcg_t``."""

    _fields_ = (("state", c.c_uint64 * 2), ("increment", c.c_uint64 * 2))


class PacketStruct(c.Structure):
    """``packet_t``."""

    _fields_ = (("arrival", c.c_int64), ("sample", c.c_int64))


class TableStruct(c.Structure):
    """``table_t``."""

    _fields_ = (
        *((n, c.c_double) for n in ("low", "width", "high")),
        ("draws", c.c_int64),
        ("samples", c.c_int64),
        ("lost", c.c_double),
        ("h", c.c_double),
        *((n, c.c_int64) for n in ("n_s", "n_r", "buffer")),
        ("rule", c.c_int32),
        ("reserved", c.c_int32),
        ("delay", PcgStruct),
        ("loss", PcgStruct),
        *((n, c.c_double) for n in ("drawn", "played")),
        *((n, c.c_int64) for n in ("rest", "row", "sent", "held", "arrived")),
        ("pending", c.c_void_p),
        ("n_pending", c.c_int64),
        ("capacity", c.c_int64),
        ("delays", c.c_void_p),
        ("rows", c.c_void_p),
        ("n", c.c_int64),
    )


class AgesStruct(c.Structure):
    """``ages_t``."""

    _fields_ = (
        *((n, c.c_int64) for n in ("n_s", "n_r", "row", "held", "backwards", "waiting", "used")),
        ("newest", c.c_int64),
        ("before", c.c_int64),
        ("counts", c.c_void_p),
        ("n_counts", c.c_int64),
        ("seen", c.c_void_p),
        ("last", c.c_int64),
        ("rows", c.c_void_p),
        ("n", c.c_int64),
    )


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The engine's library, which has the functions. Raises CosimError."""
    engine = structs.library()
    engine.tables_seed.argtypes = (c.c_void_p, c.c_int64, c.c_void_p, c.c_void_p)
    engine.tables_seed.restype = None
    engine.tables_rows.argtypes = (c.c_void_p, c.c_int64)
    engine.tables_rows.restype = c.c_int64
    for function in (engine.ages_reach, engine.ages_count):
        function.argtypes, function.restype = (c.c_void_p, c.c_int64), None
    engine.ages_ranks.argtypes = (c.c_void_p, c.c_int64, c.c_void_p, c.c_int64, c.c_void_p)
    engine.ages_ranks.restype = None
    return engine
