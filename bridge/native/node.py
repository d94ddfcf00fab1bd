"""``node.h``, ``gates.h`` and the functions of a node on its clocks, as ctypes sees them."""

from __future__ import annotations

import ctypes as c
from functools import lru_cache
from typing import Any

from bridge.native import faults, message, safety
from bridge.native.commanded import CommandedStruct, DriveEvents
from bridge.native.delay import Delay
from bridge.native.epoch import Epoch
from bridge.native.frame import Frame
from bridge.native.journal import JournalStruct
from bridge.native.library import library
from bridge.native.network import NetworkStruct, RouteStruct
from bridge.native.pace import Histogram
from bridge.native.vendor import PARTS, VendorStruct

WALL, SIMULATED, REPLAY = 1, 2, 3
#: Flags of a row: a missed slot, done late; a component failed; drives disabled; all ready.
BURST, FAILED, DISABLED, ENABLED = 1, 2, 4, 8
RAISED = 1  # of `alarm`: emergency stop
UNKNOWN, THERE = 0, 1  # a sample in a replay
FINISHED, STOPPED, NEVER_STARTED, FAULT, NOT_JOINED = 0, -1, -2, -3, -4
#: Called with the slot in which a life begins in the middle of a run; returns 0 where it can.
Joined = c.CFUNCTYPE(c.c_int32, c.c_int64)

Doubles = c.POINTER(c.c_double)


class HistoryStruct(c.Structure):
    """``history_t``."""

    _fields_ = (
        ("first", c.c_int64),
        ("count", c.c_int64),
        ("capacity", c.c_int64),
        ("width", c.c_int32),
        ("reserved", c.c_int32),
        ("values", c.c_void_p),
        ("there", c.c_void_p),
    )


class ForwardStruct(c.Structure):
    """``forward_t``."""

    _fields_ = (
        ("message", c.POINTER(message.Message)),
        ("sources", c.c_void_p),
        ("values", c.c_void_p),
        ("width", c.c_int32),
        ("bus", c.c_int32),
        ("of", c.POINTER(HistoryStruct)),
        ("to", c.POINTER(HistoryStruct)),
        ("sent", c.c_int64),
        ("failed", c.c_int64),
        ("transit", Histogram),
    )


class Reception(c.Structure):
    """``reception_t``."""

    _fields_ = (
        ("message", c.POINTER(message.Message)),
        ("receiver", c.POINTER(message.Receiver)),
        ("values", c.c_void_p),
        ("width", c.c_int32),
        ("bus", c.c_int32),
        ("period_ns", c.c_int64),
        ("offset_ns", c.c_int64),
        ("limits", c.POINTER(message.Limit)),
        ("max_age_ns", c.c_int64),
        ("newest", c.c_int64),
        ("arrival_ns", c.c_int64),
        ("previewed_ns", c.c_int64),
        ("accept_simulated", c.c_int32),
        ("awaited", c.c_int32),
        ("of_fault", c.c_int32),
        ("drive", c.c_int32),
        ("transit_ns", c.c_int64),
        ("history", c.POINTER(HistoryStruct)),
        ("sender", c.c_int32),
        ("n_forwards", c.c_int32),
        ("forwards", c.POINTER(ForwardStruct)),
        ("promised", c.c_int64),
        ("early_range", c.c_int64),
        ("misfits", c.c_int64),
        ("early", c.c_int64),
        ("early_life", c.c_int32),
        ("reserved2", c.c_int32),
        ("early_ns", c.c_int64),
    )


class Apart(c.Structure):
    """``apart_t``."""

    _fields_ = (
        ("a", c.POINTER(Reception)),
        ("b", c.POINTER(Reception)),
        ("first_a", c.c_int32),
        ("first_b", c.c_int32),
        ("count", c.c_int32),
        ("reserved", c.c_int32),
        ("within", c.c_double),
    )


class MotorFault(c.Structure):
    """``motor_fault_t``."""

    _fields_ = (("t_ns", c.c_int64), ("fault", c.c_int32), ("code", c.c_int32))


class MotorStruct(c.Structure):
    """``motor_t``."""

    _fields_ = (
        ("vendor", VendorStruct),
        ("bus", c.c_int32),
        ("outlets", c.c_int32 * PARTS),
        ("reserved", c.c_int32),
        ("power", c.c_int64),
        ("faults", c.POINTER(MotorFault)),
        ("n_faults", c.c_int32),
        ("happened", c.c_int32),
    )


class InletStruct(c.Structure):
    """``inlet_t``."""

    _fields_ = (
        ("node", c.c_void_p),
        ("reception", c.POINTER(Reception)),
        ("delay", c.POINTER(Delay)),
        ("first", c.c_int32),
        ("count", c.c_int32),
        ("target", c.c_int64),
        ("gain", c.c_double),
        ("offset", c.c_double),
        ("age", c.c_int64),
        ("stop_ns", c.c_int64),
        ("period", c.c_int64),
        ("drive", c.POINTER(safety.DriveStruct)),
        ("max_age_ns", c.c_int64),
        ("q", c.c_int64),
        ("dq", c.c_int64),
        ("command", c.c_void_p),
        ("held", c.c_int64),
        ("newest", c.c_int64),
        ("last_newest", c.c_int64),
        ("heard_ns", c.c_int64),
        ("initial", c.c_void_p),
        ("begun", c.c_int32),
        ("reserved", c.c_int32),
        ("link_age", c.c_int64),
        ("later", c.c_int64),
        ("motor", c.POINTER(MotorStruct)),
        ("ignored", c.c_int64),
        ("faults", c.POINTER(MotorFault)),
        ("n_faults", c.c_int32),
        ("happened", c.c_int32),
        ("hot", c.c_int32),
        ("drops", c.c_int32),
        ("asked", c.c_uint32),
        ("reserved3", c.c_uint32),
        ("requests", c.c_int64),
        ("tripped", c.c_int32),
        ("reserved2", c.c_int32),
    )


class OutletStruct(c.Structure):
    """``outlet_t``."""

    _fields_ = (
        ("node", c.c_void_p),
        ("message", c.POINTER(message.Message)),
        ("width", c.c_int32),
        ("bus", c.c_int32),
        ("sources", c.c_void_p),
        ("values", c.c_void_p),
        ("every", c.c_int64),
        ("hit_ticks", c.c_int64),
        ("guard", c.POINTER(safety.Guard)),
        ("guarded", c.c_int32),
        ("joints", c.c_int32),
        ("q", c.c_int64),
        ("dq", c.c_int64),
        ("drive", c.POINTER(safety.DriveStruct)),
        ("measured_q", c.c_int32),
        ("measured_dq", c.c_int32),
        ("history", c.POINTER(HistoryStruct)),
        ("sent", c.c_int64),
        ("saturated", c.c_int64),
        ("forwards", c.POINTER(ForwardStruct)),
        ("n_forwards", c.c_int64),
        ("commanded", c.POINTER(CommandedStruct)),
        ("motor", c.POINTER(MotorStruct)),
        ("part", c.c_int64),
    )


class Services(c.Structure):
    """``services_t``."""

    _fields_ = (
        ("heartbeat", c.POINTER(message.Message)),
        ("sync", c.POINTER(message.Message)),
        ("nmt", c.POINTER(message.Message)),
        ("estop", c.POINTER(message.Message)),
        ("epoch", c.POINTER(message.Message)),
        ("peers", c.c_void_p),
        ("host_heartbeat", c.POINTER(message.Message)),
        ("host_sync", c.POINTER(message.Message)),
        ("host_sync_slots", c.c_int64),
    )


class Inside(c.Structure):
    """``inside_t``."""

    _fields_ = (
        ("node", c.c_void_p),
        ("guard", c.POINTER(safety.Guard)),
        ("tau", c.c_int64),
        ("q", c.c_int64),
        ("dq", c.c_int64),
    )


class PlayedStruct(c.Structure):
    """``played_t``."""

    _fields_ = (("row", c.c_void_p), ("period", c.c_int64))


class NodeStruct(c.Structure):
    """``node_t``."""

    _fields_ = (
        ("engine", c.c_void_p),
        ("run", c.c_void_p),
        ("signals", c.c_void_p),
        ("record", c.c_void_p),
        ("record_row", c.c_void_p),
        ("clock", c.c_int32),
        ("number", c.c_int32),
        ("h_ns", c.c_int64),
        ("phase_ns", c.c_int64),
        ("h", c.c_double),
        ("slot", c.c_int64),
        ("first", c.c_int64),
        ("slots", c.c_int64),
        ("start_ns", c.c_int64),
        ("asked_ns", c.c_int64),
        ("nmt_ns", c.c_int64),
        ("now_ns", c.c_int64),
        ("overrun_ns", c.c_int64),
        ("told", c.c_uint32),
        ("quit", c.c_int32),
        ("simulated", c.c_int32),
        ("result", c.c_int32),
        ("buses", c.c_void_p),
        ("receptions", c.c_void_p),
        ("inlets", c.c_void_p),
        ("outlets", c.c_void_p),
        ("insides", c.c_void_p),
        ("peers", c.c_void_p),
        ("faults", c.POINTER(faults.Faults)),
        ("n_buses", c.c_int32),
        ("n_receptions", c.c_int32),
        ("n_inlets", c.c_int32),
        ("n_outlets", c.c_int32),
        ("n_peers", c.c_int32),
        ("n_insides", c.c_int32),
        ("life", safety.LifeStruct),
        ("services", c.POINTER(Services)),
        ("heartbeat_slots", c.c_int64),
        ("sync_slots", c.c_int64),
        ("host_ns", c.c_int64),
        ("host_due_ns", c.c_int64),
        ("host_sync_ns", c.c_int64),
        ("boots", c.c_uint32),
        ("sync_count", c.c_uint32),
        ("syncs_received", c.c_int64),
        ("syncs_lost", c.c_int64),
        ("sync_last", c.c_int32),
        ("sync_watchdog", safety.WatchdogStruct),
        ("aparts", c.c_void_p),
        ("n_aparts", c.c_int32),
        ("begun", c.c_int32),
        ("ending", c.c_int32),
        ("refusals", c.c_int32),
        ("refused", c.c_uint32),
        ("beats", c.c_uint32),
        ("alarm", c.c_int32),
        ("alarms", c.c_int32),
        ("alarm_ns", c.c_int64),
        ("journal", c.POINTER(JournalStruct)),
        ("heard", c.POINTER(JournalStruct)),
        ("inlet_offset", c.c_int64),
        ("outlet_offset", c.c_int64),
        ("signals_offset", c.c_int64),
        ("replayed", c.c_void_p),
        ("replayed_rows", c.c_int64),
        ("row_size", c.c_int64),
        ("replay_row", c.c_int64),
        ("late", Histogram),
        ("missed", c.c_int64),
        ("spin_ns", c.c_int64),
        ("done_ns", c.c_int64),
        ("send_ns", c.c_int64),
        ("stopping", c.c_int64),
        ("unknown", c.c_int64),
        ("pending", c.POINTER(Frame)),
        ("has_pending", c.c_void_p),
        ("played", c.POINTER(PlayedStruct)),
        ("n_played", c.c_int64),
        ("gateway", c.c_int64),
        ("patience_ns", c.c_int64),
        ("lead_ns", c.c_int64),
        ("joined", Joined),
        ("epoch", Epoch),
        ("commanded", c.POINTER(CommandedStruct)),
        ("n_commanded", c.c_int32),
        ("deferred", c.c_int32),
        ("feed_ns", c.c_int64),
        ("fed_ns", c.c_int64),
        ("disable_ns", c.c_int64),
        ("drive_events", DriveEvents),
        ("motors", c.POINTER(MotorStruct)),
        ("n_motors", c.c_int64),
        ("late_starts", c.c_int64),
        ("damaged", c.c_int64),
    )


def pointer_to(struct: MotorStruct) -> Any:
    """A pointer to an element of an array; it does not keep the array alive."""
    return c.cast(c.addressof(struct), c.POINTER(MotorStruct))


@lru_cache(maxsize=1)
def functions() -> c.CDLL:
    """The library with the functions of a node declared. Raises CosimError without it."""
    found = library()
    node, i32 = c.POINTER(NodeStruct), c.c_int32
    found.node_live.argtypes, found.node_live.restype = (node,), i32
    found.node_tell.argtypes, found.node_tell.restype = (node, i32), None
    found.node_enable.argtypes, found.node_enable.restype = (node, c.c_int64), None
    found.node_origin.argtypes = (node, c.c_int64, c.c_int64)
    found.node_origin.restype = c.c_int64
    found.node_replay.argtypes, found.node_replay.restype = (node,), i32
    found.node_unheard.argtypes, found.node_unheard.restype = (node, i32), i32
    found.node_absent.argtypes, found.node_absent.restype = (node, i32, c.c_int64), i32
    found.nodes_simulate.argtypes = (
        *(c.c_void_p, i32, c.POINTER(NetworkStruct), i32),
        *(c.POINTER(RouteStruct), i32, c.c_int64),
    )
    found.nodes_simulate.restype = i32
    found.bringup_ready.argtypes, found.bringup_ready.restype = (node, c.c_int64), i32
    found.bringup_hear.argtypes, found.bringup_hear.restype = (node, c.POINTER(Frame)), i32
    found.bringup_step.argtypes = (node, c.c_int64, i32)
    found.bringup_step.restype = c.c_uint32
    for function in (found.bringup_rest, found.node_host, found.node_host_sync_early):
        function.argtypes, function.restype = (node, c.c_int64), None
    found.bringup_feed_until.argtypes = (node, c.POINTER(i32))
    found.bringup_feed_until.restype = None
    found.node_step.argtypes, found.node_step.restype = (node,), i32
    found.node_follow.argtypes = (node, c.c_void_p, c.c_int64)
    found.node_follow.restype = i32
    return found


def address(name: str) -> int:
    """Of a function of the library."""
    value = c.cast(getattr(library(), name), c.c_void_p).value
    assert value is not None
    return value
