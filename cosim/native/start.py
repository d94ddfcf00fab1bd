"""The start of components as C sees it (``start.h`` is the definition)."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum
from functools import lru_cache

from cosim.native import structs


class Stage(IntEnum):
    """``STAGE_``: into Initialization Mode; outputs for inputs; out of it."""

    ENTER = 0
    SAY = 1
    LEAVE = 2


class Form(IntEnum):
    """``FORM_``: what a call of an FMU is."""

    OTHER = 0
    NOTHING = 1
    MODE = 2
    SETUP2 = 3
    ENTER3 = 4
    VALUES2 = 5
    VALUES3 = 6


class ValuePlace(IntEnum):
    """``VALUES_``: where the values of a call are."""

    ROW = 0
    SIGNALS = 1
    EQUAL = 2


class Number(IntEnum):
    """``NUMBER_``: how values are compared."""

    WHOLE = 0
    FLOAT = 1
    DOUBLE = 2


class StartResult(IntEnum):
    """``START_``: why Python has to do something."""

    DONE = 0
    OTHER = 1
    REFUSED = 2
    DIFFERENT = 3
    CHANGED = 4
    RESTLESS = 5


class StartCallStruct(c.Structure):
    """``start_call_t``."""

    _fields_ = (
        ("function", c.c_void_p),
        ("references", c.c_void_p),
        *((n, c.c_int64) for n in ("n_references", "n_values", "place", "bytes")),
        ("tolerance", c.c_double),
        *((n, c.c_int32) for n in ("form", "values", "number", "output")),
        *((n, c.c_int32) for n in ("has_tolerance", "reserved")),
    )


class StartKindStruct(c.Structure):
    """``start_kind_t``."""

    _fields_ = (("calls", c.c_void_p), ("first", c.c_int64 * (len(Stage) + 1)))


class StartingStruct(c.Structure):
    """``starting_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("kind", "instance", "row")),
        *((n, c.c_int64) for n in ("input", "n_inputs", "output", "n_outputs")),
    )


class BringingStruct(c.Structure):
    """``bringing_t``."""

    _fields_ = (
        ("initial", c.c_void_p),
        *((n, c.c_int64) for n in ("source", "target", "count")),
        *((n, c.c_double) for n in ("gain", "offset")),
    )


class StartStruct(c.Structure):
    """``start_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("components", "order", "bringing", "fed")),
        *((n, c.c_void_p) for n in ("feeds", "first_fed", "signals", "known", "before")),
        *((n, c.c_void_p) for n in ("stale", "waiting", "asked", "unsettled", "room")),
        ("begin", c.c_double),
        *((n, c.c_int64) for n in ("n", "at", "call", "passes")),
        *((n, c.c_int32) for n in ("status", "changed", "saying", "leaving")),
    )


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The engine with the functions of the start. Raises CosimError as that does."""
    engine = structs.library()
    engine.engine_start.argtypes = (c.POINTER(StartStruct), c.c_int32)
    engine.engine_start.restype = c.c_int32
    engine.engine_settle.argtypes = (c.POINTER(StartStruct),)
    engine.engine_settle.restype = c.c_int32
    return engine
