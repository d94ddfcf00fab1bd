"""ctypes declarations of the structs and functions of the simulated bus (``cosim/c/bus/bus.h``)."""

from __future__ import annotations

import ctypes as c
import sys
from functools import lru_cache
from pathlib import Path

from cosim.base.errors import CosimError

ABI = 5


class NodeSettingsStruct(c.Structure):
    """``bus_node_settings_t``."""

    _fields_ = (
        ("queue", c.c_int32),
        ("queue_length", c.c_int32),
        ("receive_length", c.c_int32),
        ("first_filter", c.c_int32),
        ("n_filters", c.c_int32),
        ("one_shot", c.c_int32),
        ("recovers", c.c_int32),
        ("inbox", c.c_int32),
        ("tec", c.c_int32),
        ("rec", c.c_int32),
        ("clock_ppb", c.c_int32),
        ("sample_point", c.c_int32),
        ("sjw", c.c_int32),
    )


class FilterStruct(c.Structure):
    """``bus_filter_t``."""

    _fields_ = (
        ("id", c.c_uint32),
        ("mask", c.c_uint32),
        ("flags", c.c_uint32),
        ("flag_mask", c.c_uint32),
    )


class ScriptStruct(c.Structure):
    """``bus_script_t``."""

    _fields_ = (
        ("id", c.c_uint32),
        ("extended", c.c_uint32),
        ("attempt", c.c_int32),
        ("bit", c.c_int32),
        ("length", c.c_int32),
        ("node", c.c_int32),
        ("level", c.c_int32),
        ("reserved", c.c_int32),
    )


class InterruptionStruct(c.Structure):
    """``bus_interruption_t``."""

    _fields_ = (
        ("from", c.c_int64),
        ("to", c.c_int64),
        ("node", c.c_int32),
        ("level", c.c_int32),
    )


class RateStruct(c.Structure):
    """``bus_rate_t``."""

    _fields_ = (("rate", c.c_double), ("length", c.c_int32), ("node", c.c_int32))


class SettingsStruct(c.Structure):
    """``bus_settings_t``."""

    _fields_ = (
        ("bit", c.c_int64),
        ("data_bit", c.c_int64),
        ("seed", c.c_uint64),
        ("nodes", c.c_void_p),
        ("filters", c.c_void_p),
        ("scripts", c.c_void_p),
        ("interruptions", c.c_void_p),
        ("rates", c.c_void_p),
        ("n_nodes", c.c_int32),
        ("n_filters", c.c_int32),
        ("n_scripts", c.c_int32),
        ("n_interruptions", c.c_int32),
        ("n_rates", c.c_int32),
        ("record", c.c_uint32),
    )


class OutputStruct(c.Structure):
    """``bus_output_t``."""

    _fields_ = (
        ("events", c.c_void_p),
        ("frames", c.c_void_p),
        ("n_events", c.c_int64),
        ("n_frames", c.c_int64),
    )


class NodeStateStruct(c.Structure):
    """``bus_node_state_t``."""

    _fields_ = (
        ("tec", c.c_int32),
        ("rec", c.c_int32),
        ("state", c.c_int32),
        ("pending", c.c_int32),
    )


class FrameBitsStruct(c.Structure):
    """``bits_t``."""

    _fields_ = (("nominal", c.c_int32), ("data", c.c_int32))


class TickFrameStruct(c.Structure):
    """``tick_frame_t`` of ``cosim/c/bus/tick.h``."""

    _fields_ = (
        ("pending", c.c_void_p),
        ("request", c.c_void_p),
        ("places", c.c_void_p),
        ("scale", c.c_double),
        ("offset", c.c_int64),
        ("requested", c.c_int64),
        ("head", c.c_int32),
        ("count", c.c_int32),
        ("room", c.c_int32),
        ("n_places", c.c_int32),
        ("encoding", c.c_int32),
        ("reserved", c.c_int32),
    )


class TickReceiverStruct(c.Structure):
    """``tick_receiver_t``."""

    _fields_ = (
        ("table", c.c_void_p),
        ("row", c.c_int64),
        ("frame", c.c_int32),
        ("node", c.c_int32),
        ("held", c.c_int32),
        ("reserved", c.c_int32),
    )


class TickBusStruct(c.Structure):
    """``tick_bus_t``."""

    _fields_ = (
        ("bus", c.c_void_p),
        ("frames", c.c_void_p),
        ("receivers", c.c_void_p),
        ("known", c.c_void_p),
        ("owners", c.c_void_p),
        ("frame_of", c.c_void_p),
        ("sample_of", c.c_void_p),
        ("output", OutputStruct),
        ("step", c.c_int64),
        ("n_known", c.c_int64),
        ("next_known", c.c_int64),
        ("n_requests", c.c_int64),
        ("room", c.c_int64),
        ("room_events", c.c_int64),
        ("n_frames", c.c_int32),
        ("n_receivers", c.c_int32),
    )


class TickGateStruct(c.Structure):
    """``tick_gate_t``."""

    _fields_ = (("bus", c.c_void_p), ("index", c.c_int32), ("reserved", c.c_int32))


def tick_gates() -> tuple[int, int]:
    """The addresses of the gates of a sender and of a receiver. Raises CosimError."""
    bus = library()
    send, receive = (
        c.cast(function, c.c_void_p).value for function in (bus.bus_tick_send, bus.bus_tick_receive)
    )
    assert send is not None
    assert receive is not None
    return send, receive


def library_path() -> Path:
    """The path of the shared library of the simulated bus, built at installation."""
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    return Path(__file__).parent.with_name(f"_bus{suffix}")


@lru_cache(maxsize=1)
def library() -> c.CDLL:
    """The simulated bus, loaded once. Raises CosimError if it is missing or of another version."""
    path = library_path()
    if not path.is_file():
        raise CosimError(f"{path} is missing: install the project (pip install .), which builds it")
    bus = c.CDLL(str(path))
    if bus.bus_abi() != ABI:
        raise CosimError(f"{path} belongs to another version of cosim: install the project again")
    pointer, i32, i64 = c.c_void_p, c.c_int32, c.c_int64
    for name, result, arguments in (
        ("bus_size", c.c_size_t, (pointer,)),
        ("bus_create", pointer, (pointer, pointer)),
        ("bus_request", i64, (pointer, pointer, i64)),
        ("bus_abort", i32, (pointer, i32, i64)),
        ("bus_advance", i32, (pointer, i64, pointer)),
        ("bus_next", i64, (pointer,)),
        ("bus_reset", None, (pointer, i32)),
        ("bus_state", None, (pointer, i32, pointer)),
        ("bus_receive", i64, (pointer, i32, pointer, i64)),
        ("bus_whole_frames", i64, (pointer,)),
        ("bus_frame_bits", None, (pointer, pointer)),
    ):
        function = getattr(bus, name)
        function.restype, function.argtypes = result, arguments
    return bus
