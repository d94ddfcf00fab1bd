"""The memory by which an FMU in its own process is stepped: ``mailbox.h``, as ctypes sees it."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum
from functools import cache

from cosim.native import structs


class Ask(IntEnum):
    """``ASK_``: what is asked for."""

    STEP = 0
    CALL = 1


class Lost(IntEnum):
    """``LOST_``: why there is no answer."""

    NOT = 0
    ENDED = 1
    LATE = 2
    STOPPED = 3


class Mailbox(c.Structure):
    """``mailbox_t``."""

    _fields_ = (
        ("asked", c.c_uint32),
        ("asked_asleep", c.c_uint32),
        ("what", c.c_int32),
        ("stop", c.c_int32),
        ("t", c.c_double),
        ("hit", c.c_int64),
        ("apart1", c.c_int64 * 4),
        ("answered", c.c_uint32),
        ("answered_asleep", c.c_uint32),
        *((n, c.c_int32) for n in ("result", "status", "failed", "apart2")),
        ("reached", c.c_double),
        ("apart3", c.c_int64 * 4),
    )


class MailEnd(c.Structure):
    """``mail_end_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("box", "signals", "unit", "slopes", "stop")),
        ("patience", c.c_double),
        ("n_slopes", c.c_int64),
        ("seen", c.c_uint32),
        *((n, c.c_int32) for n in ("incoming", "outgoing", "bytes", "eager", "calm")),
    )


@cache
def library() -> c.CDLL:
    """The engine, with the functions of a mailbox. Raises CosimError."""
    engine = structs.library()
    for name in ("engine_ask", "engine_serve", "engine_answer"):
        getattr(engine, name).argtypes = (c.POINTER(MailEnd),)
    engine.engine_await.argtypes = (c.POINTER(MailEnd), c.c_double)
    engine.engine_await.restype = engine.engine_serve.restype = c.c_int32
    engine.engine_ask.restype = engine.engine_answer.restype = None
    return engine
