"""The C engine's structs and functions, as ctypes sees them (``engine.h`` is the definition)."""

from __future__ import annotations

import ctypes as c
import sys
from enum import IntEnum
from functools import lru_cache
from pathlib import Path

from cosim.base.errors import CosimError
from cosim.native.fmu_log import Log

ABI = 25


class Code(IntEnum):
    """``OP_``: what an operation does."""

    COPY = 0
    SCALE = 1
    PUSH = 2
    PULL = 3
    STEP = 4
    RECORD = 5
    AGE = 6
    PLAY = 7
    AHEAD = 8
    BETWEEN = 9
    GATE = 10
    SLOPE_AHEAD = 11
    SLOPE_BETWEEN = 12
    MACRO = 13


#: A line through the last two values: its mean over a step; its slope and the value it begins with.
MEANS = frozenset({Code.AHEAD, Code.BETWEEN})
SLOPES = frozenset({Code.SLOPE_AHEAD, Code.SLOPE_BETWEEN})


class UnitKind(IntEnum):
    """``UNIT_``: how a unit is stepped."""

    CALL = 0
    NATIVE = 1
    FMI2 = 2
    FMI3 = 3
    TYPED = 4
    EXCHANGE = 5
    REMOTE = 6


class EngineResult(IntEnum):
    """``RUN_``: why ``engine_run`` returned."""

    OK = 0
    STOPPED = 1
    STEP = 2
    SET = 3
    GET = 4
    NOT_FINITE = 5
    HISTORY = 6
    TERMINATED = 7
    EARLY_RETURN = 8
    VALUE = 9
    EVENT = 10
    STUCK = 11
    GATE = 12
    INTERVAL = 13
    ENDED = 14
    SOLVER = 15
    LOST = 16
    STATE = 17
    LOOP = 18


class StateMove(IntEnum):
    """``MOVE_``: what is done with the state of a unit in macro steps."""

    SAVE = 0
    BACK = 1
    SAVE_END = 2
    BACK_END = 3


class OutputRole(IntEnum):
    """``ROLE_``: what an output is in macro steps."""

    COUNTED = 0
    DIRECT = 1
    HELD = 2


class SolverKind(IntEnum):
    """``SOLVER_``: what integrates an FMU for model exchange."""

    EULER = 0
    HEUN = 1
    RK4 = 2
    CVODE = 3


class ClockKind(IntEnum):
    """``CLOCK_``: what ticks an input clock."""

    PERIODIC = 0
    CHANGING = 1
    COUNTDOWN = 2
    WIRED = 3


CALL = c.CFUNCTYPE(c.c_int32, c.c_int32, c.c_double, c.c_double)
SAVING = c.CFUNCTYPE(c.c_int32, c.c_int32, c.c_int32)
TEXTS = c.CFUNCTYPE(c.c_int32)
TEXT_ACCESS = c.CFUNCTYPE(c.c_int, c.c_void_p, c.c_void_p, c.c_size_t, c.POINTER(c.c_double))
#: ``MACRO_LEVELS``: how often a period may be halved, with no time at all.
MACRO_LEVELS = 31

#: ``LOOP_PASSES``: passes over an algebraic loop in a macro step, at most.
LOOP_PASSES = 100


class OperationStruct(c.Structure):
    """``operation_t``."""

    _fields_ = (
        ("code", c.c_int32),
        ("index", c.c_int32),
        ("period", c.c_int64),
        ("source", c.c_int64),
        ("target", c.c_int64),
        ("count", c.c_int64),
        ("gain", c.c_double),
        ("offset", c.c_double),
    )


class SegmentStruct(c.Structure):
    """``segment_t``."""

    _fields_ = tuple((n, c.c_int64) for n in ("period", "next", "first", "last"))


class StretchStruct(c.Structure):
    """``stretch_t``."""

    _fields_ = (
        *((n, c.c_int64) for n in ("place", "source", "count")),
        ("late", c.c_int32),
        ("reserved", c.c_int32),
    )


class ColumnsStruct(c.Structure):
    """``columns_t``."""

    _fields_ = (("stretches", c.c_void_p), ("n_stretches", c.c_int64))


class FailureStruct(c.Structure):
    """``failure_t``."""

    _fields_ = (
        ("operation", c.c_int64),
        ("tick", c.c_int64),
        *((n, c.c_int32) for n in ("result", "index", "status", "signal")),
    )


class SpanStruct(c.Structure):
    """``span_t``."""

    _fields_ = (("first", c.c_void_p), ("size", c.c_int64))


class ReceivedStruct(c.Structure):
    """``received_t``."""

    _fields_ = (("link", c.c_int32), ("period", c.c_int32))


class PartStruct(c.Structure):
    """``part_t``."""

    _fields_ = (
        ("segments", c.c_void_p),
        *((n, c.c_int64) for n in ("n_segments", "tick", "n_first")),
        ("links", c.c_void_p),
        ("n_links", c.c_int64),
        ("spans", c.c_void_p),
        ("n_spans", c.c_int64),
    )


class MemberStruct(c.Structure):
    """``member_t``."""

    _fields_ = (
        ("ticket", c.c_uint64),
        ("failed", FailureStruct),
        ("ended", FailureStruct),
        ("unused", c.c_int64 * 5),
    )


class TeamStruct(c.Structure):
    """``team_t``."""

    _fields_ = (
        ("finished", c.c_uint64),
        ("limit", c.c_int64),
        ("parts", c.c_void_p),
        ("places", c.c_void_p),
        ("members", c.c_void_p),
        *((n, c.c_int64) for n in ("n_parts", "n_plan", "record", "longest")),
        *((n, c.c_int32) for n in ("threads", "quit", "first", "staged")),
        *((n, c.c_int32) for n in ("stage", "stride")),
    )


class Access(c.Structure):
    """``access_t``."""

    _fields_ = (
        ("call", c.c_void_p),
        ("references", c.c_void_p),
        ("places", c.c_void_p),
        ("buffer", c.c_void_p),
        ("held", c.c_void_p),
        ("n_references", c.c_int64),
        ("count", c.c_int64),
        ("type", c.c_int32),
        ("fmi", c.c_int32),
    )


class TickerStruct(c.Structure):
    """``ticker_t``."""

    _fields_ = (
        ("reference", c.c_uint32),
        ("kind", c.c_int32),
        ("period", c.c_int64),
        ("shift", c.c_int64),
        ("next", c.c_double),
        ("place", c.c_int64),
        *((n, c.c_double) for n in ("held", "interval", "offset")),
        *((n, c.c_int64) for n in ("counter", "count", "resolution")),
        *((n, c.c_double) for n in ("origin", "due", "last")),
        ("n", c.c_int64),
        ("exact", c.c_int32),
        ("reserved", c.c_int32),
    )


class TriggeredStruct(c.Structure):
    """``triggered_t``."""

    _fields_ = (
        ("reference", c.c_uint32),
        ("n_clocks", c.c_int32),
        ("clocks", c.c_void_p),
        ("place", c.c_int64),
    )


class PartitionStruct(c.Structure):
    """``partition_t``."""

    _fields_ = (
        ("inputs", c.c_void_p),
        ("outputs", c.c_void_p),
        ("clocks", c.c_void_p),
        ("texts", c.c_void_p),
        ("n_inputs", c.c_int64),
        ("n_outputs", c.c_int64),
        ("n_clocks", c.c_int32),
        ("fed", c.c_int32),
    )


class EventTimesStruct(c.Structure):
    """``event_times_t``."""

    _fields_ = (("times", c.c_void_p), ("count", c.c_int64), ("room", c.c_int64))


class Typed(c.Structure):
    """``typed_t``."""

    _fields_ = (
        ("inputs", c.c_void_p),
        ("outputs", c.c_void_p),
        ("discrete", c.c_void_p),
        ("clocks", c.c_void_p),
        ("triggered", c.c_void_p),
        ("partitions", c.c_void_p),
        ("active", c.c_void_p),
        ("slopes", c.c_void_p),
        *((n, c.c_void_p) for n in ("orders", "starts", "stop")),
        ("enter_event", c.c_void_p),
        ("update", c.c_void_p),
        ("enter_step", c.c_void_p),
        ("set_clock", c.c_void_p),
        ("get_clock", c.c_void_p),
        *((n, c.c_void_p) for n in ("get_interval", "get_fraction", "activate", "log", "happened")),
        ("n_inputs", c.c_int64),
        ("n_outputs", c.c_int64),
        ("n_discrete", c.c_int64),
        ("n_clocks", c.c_int64),
        ("n_triggered", c.c_int64),
        ("n_partitions", c.c_int64),
        ("next_event", c.c_double),
        ("latest", c.c_double),
        ("late", c.c_int64),
        ("fmi", c.c_int32),
        ("variable", c.c_int32),
        ("asks", c.c_int32),
        ("unused", c.c_int32),
    )


class ExchangeStruct(c.Structure):
    """``exchange_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("set_time", "set_states", "get_states", "derivatives")),
        *((n, c.c_void_p) for n in ("indicators", "nominals", "completed", "enter_event")),
        *((n, c.c_void_p) for n in ("update", "enter_continuous", "directional")),
        *((n, c.c_void_p) for n in ("states", "rates", "memory")),
        *((n, c.c_int64) for n in ("n_states", "n_indicators", "n_references")),
        *((n, c.c_double) for n in ("longest", "now", "next_event")),
        *((n, c.c_int64) for n in ("steps", "evaluations", "events")),
        *((n, c.c_int32) for n in ("fmi", "solver", "fresh", "status")),
        *((n, c.c_void_p) for n in ("cvode", "vector", "advance", "restart", "stop_time")),
        *((n, c.c_void_p) for n in ("dense", "tolerances", "data", "column", "absolute")),
        ("tolerance", c.c_double),
        ("current", c.c_void_p),
    )


#: ``AT_ONCE``: units that are stepped together, at most.
AT_ONCE = 8


class UnitStruct(c.Structure):
    """``unit_t``."""

    _fields_ = (
        ("kind", c.c_int32),
        ("lag", c.c_int32),
        ("h", c.c_double),
        ("instance", c.c_void_p),
        ("set", c.c_void_p),
        ("step", c.c_void_p),
        ("get", c.c_void_p),
        ("inputs", c.c_void_p),
        ("outputs", c.c_void_p),
        ("n_inputs", c.c_int64),
        ("n_outputs", c.c_int64),
        ("input", c.c_int64),
        ("input_count", c.c_int64),
        ("output", c.c_int64),
        ("output_count", c.c_int64),
        ("typed", c.c_void_p),
        ("period", c.c_int64),
        ("reached", c.c_double),
        ("exchange", c.c_void_p),
        ("steps", c.c_void_p),
        ("values", c.c_void_p),
        ("repeats", c.c_int32),
        ("reserved", c.c_int32),
    )


class BlockStruct(c.Structure):
    """``block_t``."""

    _fields_ = (("place", c.c_void_p), ("size", c.c_int64))


class RollbackStruct(c.Structure):
    """``rollback_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("save", "restore", "call")),
        ("states", c.c_void_p * 2),
        ("blocks", c.c_void_p),
        ("copies", c.c_void_p * 2),
        ("roles", c.c_void_p),
        *((n, c.c_int64) for n in ("n_blocks", "first", "wire", "n_wires", "input")),
        *((n, c.c_int32) for n in ("unit", "coupled", "ended", "reserved")),
    )


class BondStruct(c.Structure):
    """``bond_t``."""

    _fields_ = (
        *((n, c.c_int64) for n in ("effort", "effort_input", "flow", "flow_input")),
        *((n, c.c_int64) for n in ("effort_start", "flow_start", "count", "residual")),
        *((n, c.c_double) for n in ("effort_gain", "flow_gain", "total", "largest")),
    )


class LoopStruct(c.Structure):
    """``loop_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("members", "outputs", "places", "memory")),
        *((n, c.c_int64) for n in ("n_members", "n_outputs", "n_fed_back")),
        *((n, c.c_int64) for n in ("n_kept", "kept", "solved", "passes")),
        ("left", c.c_double),
    )


class MacroStruct(c.Structure):
    """``macro_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("members", "wires", "bonds", "memory", "direct", "loops")),
        *((n, c.c_int64) for n in ("n_loops", "n_direct")),
        *((n, c.c_int64) for n in ("n_members", "n_wires", "n_bonds", "n_inputs", "n_outputs")),
        *((n, c.c_int64) for n in ("period", "steps", "rejections", "size")),
        *((n, c.c_double) for n in ("tolerance", "absolute", "error")),
        *((n, c.c_int32) for n in ("level", "error_level", "halvings", "iterations")),
        *((n, c.c_int32) for n in ("repeated", "reserved")),
        ("accepted", c.c_int64 * MACRO_LEVELS),
        ("rejected", c.c_int64 * MACRO_LEVELS),
        ("forced", c.c_int64),
        *((n, c.c_double) for n in ("worst", "forced_at")),
    )


class SenderStruct(c.Structure):
    """``sender_t``."""

    _fields_ = (
        ("history", c.c_void_p),
        *((n, c.c_int64) for n in ("width", "sent", "capacity")),
    )


class LinkStruct(c.Structure):
    """``link_t``."""

    _fields_ = (
        *((n, c.c_void_p) for n in ("sender", "table", "initial")),
        *((n, c.c_int64) for n in ("row", "rows", "held", "before")),
    )


class PlayerStruct(c.Structure):
    """``player_t``."""

    _fields_ = (("values", c.c_void_p), ("row", c.c_int64), ("rows", c.c_int64))


class GateStruct(c.Structure):
    """``gate_t``: ``int32_t passing(void *context, int64_t tick, double *signals)`` of C."""

    _fields_ = (("passing", c.c_void_p), ("context", c.c_void_p))


class EngineState(c.Structure):
    """``engine_t``."""

    _fields_ = (
        ("operations", c.c_void_p),
        ("segments", c.c_void_p),
        ("team", c.c_void_p),
        ("units", c.c_void_p),
        *((n, c.c_void_p) for n in ("links", "senders", "players", "gates", "macros", "signals")),
        *((n, c.c_void_p) for n in ("record", "columns", "recorded")),
        *((n, c.c_int64) for n in ("n_segments", "width", "row", "tick")),
        ("failed_tick", c.c_int64),
        ("every", c.c_int64),
        ("h", c.c_double),
        ("start", c.c_double),
        ("stop", c.c_int32),
        ("failed_index", c.c_int32),
        ("failed_status", c.c_int32),
        ("failed_signal", c.c_int32),
    )


def library_path() -> Path:
    """Where the engine's shared library is, built at installation."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    return Path(__file__).parent.with_name(f"_engine{suffix}")


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The engine, loaded once. Raises CosimError when it is missing or of another version."""
    path = library_path()
    if not path.is_file():
        raise CosimError(f"{path} is missing: install the project (pip install .), which builds it")
    engine = c.CDLL(str(path))
    engine.engine_run.argtypes = (c.POINTER(EngineState), c.c_int64)
    engine.engine_run.restype = c.c_int32
    engine.engine_run_many.argtypes = (c.c_void_p, *[c.c_int64] * 4, c.c_void_p)
    engine.engine_run_many.restype = None
    engine.engine_work.argtypes = (c.POINTER(EngineState), c.c_int32)
    engine.engine_work.restype = c.c_int32
    engine.engine_sizes.argtypes = (c.c_int32,)
    engine.engine_sizes.restype = c.c_size_t
    engine.engine_unit.argtypes = (
        *(c.c_void_p, c.c_void_p, c.c_double, c.c_int64, c.c_void_p, c.c_void_p),
    )
    structs = (
        *(OperationStruct, UnitStruct, LinkStruct, EngineState, Log, PlayerStruct, Access),
        *(TickerStruct, Typed, GateStruct, TriggeredStruct, PartitionStruct),
        *(ExchangeStruct, SegmentStruct, FailureStruct, TeamStruct),
        *(MemberStruct, StretchStruct, ColumnsStruct, SenderStruct, PartStruct),
        *(BlockStruct, RollbackStruct, BondStruct, MacroStruct, SpanStruct, ReceivedStruct),
        LoopStruct,
    )
    expected = [c.sizeof(t) for t in structs]
    found = [engine.engine_sizes(i) for i in range(len(expected))]
    if engine.engine_abi() != ABI or found != expected:
        raise CosimError(f"{path} belongs to another version of cosim: install the project again")
    return engine


def address(function: object) -> int:
    """The address of a ctypes function or call-back."""
    value = c.cast(function, c.c_void_p).value  # type: ignore[arg-type]
    assert value is not None
    return value
