"""``commanded.h``: a drive as the node sees it that commands it, as ctypes sees it."""

from __future__ import annotations

import ctypes as c
from enum import IntEnum

from bridge.native.bus import Accept
from bridge.native.frame import Frame


class Told(IntEnum):
    """``TOLD_``: meaning of a state that a drive tells."""

    OTHER = 0
    DISABLED = 1
    RAMPING = 2
    ENABLED = 3
    FAULT = 4


class StepKind(IntEnum):
    """``STEP_``: kind of the answer to a step."""

    NO_ANSWER = 0
    STATE = 1
    FRAME = 2


class Phase(IntEnum):
    """``DRIVE_RESTING`` and so on: what its node does with a drive."""

    RESTING = 0
    RISING = 1
    SERVING = 2
    FAILED = 3


class Failure(IntEnum):
    """``FAILED_``: the reason for which a node gave up a drive."""

    NOT = 0
    ANSWER = 1
    VALUE = 2
    STATE = 3
    SILENT = 4
    FORMAT = 5
    NUMBER = 6
    STILL = 7


class ToldStruct(c.Structure):
    """``told_t``."""

    _fields_ = (
        ("mask", c.c_uint64),
        ("value", c.c_uint64),
        ("kind", c.c_int32),
        ("differs", c.c_int32),
    )


class StepStruct(c.Structure):
    """``step_t``."""

    _fields_ = (
        ("frame", Frame),
        ("kind", c.c_int32),
        ("reserved", c.c_int32),
        ("states", c.c_uint64),
        ("answer", Accept),
        ("mask", c.c_uint64),
        ("value", c.c_uint64),
        ("exact", c.c_uint64),
        ("within_ns", c.c_int64),
        ("again_ns", c.c_int64),
    )


class CommandedStruct(c.Structure):
    """``commanded_t``."""

    _fields_ = (
        ("status", Accept),
        ("told", c.POINTER(ToldStruct)),
        ("steps", c.POINTER(StepStruct)),
        ("disabling", c.POINTER(Frame)),
        ("feed", Frame),
        ("n_told", c.c_int32),
        ("n_steps", c.c_int32),
        ("n_disabling", c.c_int32),
        ("bus", c.c_int32),
        ("own_mask", c.c_uint64),
        ("own", c.c_uint64),
        ("format", c.c_uint32),
        ("feeds", c.c_int32),
        ("within_ns", c.c_int64),
        ("phase", c.c_int32),
        ("step", c.c_int32),
        ("row", c.c_int32),
        ("failure", c.c_int32),
        ("failed_step", c.c_int32),
        ("let_down", c.c_int32),
        ("word", c.c_uint64),
        ("failed_word", c.c_uint64),
        ("heard", c.c_int64),
        ("told_ns", c.c_int64),
        ("began_ns", c.c_int64),
        ("sent_ns", c.c_int64),
        ("up_ns", c.c_int64),
        ("answered", c.c_int32),
        ("reserved", c.c_int32),
        ("q_of", c.c_int32),
        ("q_at", c.c_int32),
        ("dq_of", c.c_int32),
        ("dq_at", c.c_int32),
        ("q_newest", c.c_int64),
        ("q_last", c.c_double),
        ("moved", c.c_double),
    )


class DriveEvent(c.Structure):
    """``drive_event_t``."""

    _fields_ = (
        ("t_ns", c.c_int64),
        ("drive", c.c_int32),
        ("phase", c.c_int32),
        ("row", c.c_int32),
        ("failure", c.c_int32),
        ("word", c.c_uint64),
    )


class DriveEvents(c.Structure):
    """``drive_events_t``."""

    _fields_ = (
        ("events", c.POINTER(DriveEvent)),
        ("n", c.c_int64),
        ("capacity", c.c_int64),
    )
