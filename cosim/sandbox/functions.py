"""The functions of FMI 3.0 for co-simulation as C has them, each of which calls a component.

The first argument is a handle of :data:`cosim.sandbox.instances.GUESTS`; a function returns the
status. What a call of a component cannot do in FMI's way, such as a trap, is a fatal status.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from wasmtime.component import Record

from cosim.sandbox.instances import HANDLES, OK, Entry, Function, status
from cosim.sandbox.numbers import NUMBERS
from cosim.sandbox.runtime import Trap

_QUALIFIERS = ("interval-not-yet-known", "interval-unchanged", "interval-changed")
_P, _N, _B, _D = c.c_void_p, c.c_size_t, c.c_bool, c.c_double


def _list(kind: Any, address: int, n: int) -> list[Any]:
    return list((kind * n).from_address(address)) if n else []


def _write(kind: Any, address: int, values: Sequence[Any]) -> None:
    if values:
        (kind * len(values)).from_address(address)[:] = values


def _plain(method: str) -> Function:
    return Function((), lambda entry: status(entry.guest.call(method)))


def _initialize(
    entry: Entry, has_tolerance: bool, tolerance: float, start: float, has_stop: bool, stop: float
) -> int:
    given = tolerance if has_tolerance else None, start, stop if has_stop else None
    return status(entry.guest.call("enter-initialization-mode", *given))


def _update(entry: Entry, *places: int) -> int:
    found = entry.guest.call("update-discrete-states")
    if not isinstance(found, Record):
        return status(found)
    *flags, time = vars(found).values()
    for place, flag in zip(places, flags, strict=False):
        c.c_bool.from_address(place).value = flag
    c.c_double.from_address(places[-1]).value = time
    return OK


def _get_texts(entry: Entry, references: int, n: int, values: int, size: int) -> int:
    found = entry.guest.call("get-string", _list(c.c_uint32, references, n))
    return _put_texts(entry, found, values, size, lambda text: text.encode())


def _put_texts(
    entry: Entry, found: Any, values: int, size: int, bytes_of: Callable[[Any], bytes]
) -> int:
    if isinstance(found, str):
        return status(found)
    if len(found) != size:
        raise Trap(f"returned {len(found)} values, expected {size}")
    entry.texts = [c.create_string_buffer(bytes_of(one)) for one in found]
    _write(c.c_void_p, values, [c.addressof(one) for one in entry.texts])
    return OK


def _set_texts(entry: Entry, references: int, n: int, values: int, size: int) -> int:
    texts = [(one or b"").decode("utf-8", "replace") for one in _list(c.c_char_p, values, size)]
    return status(entry.guest.call("set-string", _list(c.c_uint32, references, n), texts))


def _get_binary(entry: Entry, references: int, n: int, sizes: int, values: int, size: int) -> int:
    found = entry.guest.call("get-binary", _list(c.c_uint32, references, n))
    found_status = _put_texts(entry, found, values, size, bytes)
    if found_status == OK:
        _write(c.c_size_t, sizes, [len(one) for one in found])
    return found_status


def _set_binary(entry: Entry, references: int, n: int, sizes: int, values: int, size: int) -> int:
    lengths, places = _list(c.c_size_t, sizes, size), _list(c.c_void_p, values, size)
    blobs = [c.string_at(p, k) if k else b"" for p, k in zip(places, lengths, strict=True)]
    return status(entry.guest.call("set-binary", _list(c.c_uint32, references, n), blobs))


def _get_clock(entry: Entry, references: int, n: int, values: int) -> int:
    found = entry.guest.call("get-clock", _list(c.c_uint32, references, n))
    if isinstance(found, str):
        return status(found)
    _write(c.c_bool, values, found)
    return OK


def _set_clock(entry: Entry, references: int, n: int, values: int) -> int:
    given = _list(c.c_uint32, references, n), _list(c.c_bool, values, n)
    return status(entry.guest.call("set-clock", *given))


def _get_interval(entry: Entry, references: int, n: int, intervals: int, qualifiers: int) -> int:
    found = entry.guest.call("get-interval-decimal", _list(c.c_uint32, references, n))
    if isinstance(found, str):
        return status(found)
    _write(c.c_double, intervals, [seconds for seconds, _ in found])
    _write(c.c_int, qualifiers, [_QUALIFIERS.index(name) for _, name in found])
    return OK


def _get_interval_fraction(
    entry: Entry, references: int, n: int, counters: int, resolutions: int, qualifiers: int
) -> int:
    found = entry.guest.call("get-interval-fraction", _list(c.c_uint32, references, n))
    if isinstance(found, str):
        return status(found)
    _write(c.c_uint64, counters, [x.counter for x, _ in found])
    _write(c.c_uint64, resolutions, [x.resolution for x, _ in found])
    _write(c.c_int, qualifiers, [_QUALIFIERS.index(name) for _, name in found])
    return OK


def _get_shift(entry: Entry, references: int, n: int, shifts: int) -> int:
    found = entry.guest.call("get-shift-decimal", _list(c.c_uint32, references, n))
    if isinstance(found, str):
        return status(found)
    _write(c.c_double, shifts, found)
    return OK


def _get_shift_fraction(
    entry: Entry, references: int, n: int, counters: int, resolutions: int
) -> int:
    found = entry.guest.call("get-shift-fraction", _list(c.c_uint32, references, n))
    if isinstance(found, str):
        return status(found)
    _write(c.c_uint64, counters, [x.counter for x in found])
    _write(c.c_uint64, resolutions, [x.resolution for x in found])
    return OK


def _set_decimals(method: str) -> Function:
    def call(entry: Entry, references: int, n: int, seconds: int) -> int:
        given = _list(c.c_uint32, references, n), _list(c.c_double, seconds, n)
        return status(entry.guest.call(method, *given))

    return Function((_P, _N, _P), call)


def _set_fractions(method: str) -> Function:
    def call(entry: Entry, references: int, n: int, counters: int, resolutions: int) -> int:
        pairs = zip(_list(c.c_uint64, counters, n), _list(c.c_uint64, resolutions, n), strict=True)
        fractions = []
        for counter, resolution in pairs:
            fraction = Record()
            vars(fraction).update(counter=counter, resolution=resolution)
            fractions.append(fraction)
        return status(entry.guest.call(method, _list(c.c_uint32, references, n), fractions))

    return Function((_P, _N, _P, _P), call)


def _get_state(entry: Entry, place: int) -> int:
    found = entry.guest.call("get-fmu-state")
    if isinstance(found, str):
        return status(found)
    pointer = c.c_void_p.from_address(place)
    number = pointer.value or next(HANDLES)
    entry.states[number], pointer.value = bytes(found), number
    return OK


def _set_state(entry: Entry, number: int) -> int:
    return status(entry.guest.call("set-fmu-state", entry.states[number]))


def _free_state(entry: Entry, place: int) -> int:
    pointer = c.c_void_p.from_address(place)
    entry.states.pop(pointer.value or 0, None)
    pointer.value = None
    return OK


def _state_size(entry: Entry, number: int, size: int) -> int:
    c.c_size_t.from_address(size).value = len(entry.states[number])
    return OK


def _write_state(entry: Entry, number: int, place: int, size: int) -> int:
    c.memmove(place, entry.states[number], size)
    return OK


def _read_state(entry: Entry, place: int, size: int, state: int) -> int:
    number = next(HANDLES)
    entry.states[number] = c.string_at(place, size)
    c.c_void_p.from_address(state).value = number
    return OK


def _directional(entry: Entry, unknowns: int, n: int, knowns: int, m: int, *rest: int) -> int:
    seed, k, out, size = rest
    given = _list(c.c_uint32, unknowns, n), _list(c.c_uint32, knowns, m), _list(c.c_double, seed, k)
    found = entry.guest.call("get-directional-derivative", *given)
    if isinstance(found, str):
        return status(found)
    if len(found) != size:
        raise Trap(f"returned {len(found)} values, expected {size}")
    _write(c.c_double, out, found)
    return OK


#: The functions by name, without ``fmi3``.
FUNCTIONS: Mapping[str, Function] = {
    **NUMBERS,
    **{
        name: _plain(method)
        for name, method in {
            "EnterConfigurationMode": "enter-configuration-mode",
            "ExitConfigurationMode": "exit-configuration-mode",
            "ExitInitializationMode": "exit-initialization-mode",
            "EnterEventMode": "enter-event-mode",
            "EnterStepMode": "enter-step-mode",
            "EvaluateDiscreteStates": "evaluate-discrete-states",
            "Terminate": "terminate",
            "Reset": "reset",
        }.items()
    },
    "EnterInitializationMode": Function((_B, _D, _D, _B, _D), _initialize),
    "UpdateDiscreteStates": Function((_P,) * 6, _update),
    "GetString": Function((_P, _N, _P, _N), _get_texts),
    "SetString": Function((_P, _N, _P, _N), _set_texts),
    "GetBinary": Function((_P, _N, _P, _P, _N), _get_binary),
    "SetBinary": Function((_P, _N, _P, _P, _N), _set_binary),
    "GetClock": Function((_P, _N, _P), _get_clock),
    "SetClock": Function((_P, _N, _P), _set_clock),
    "GetIntervalDecimal": Function((_P, _N, _P, _P), _get_interval),
    "GetIntervalFraction": Function((_P, _N, _P, _P, _P), _get_interval_fraction),
    "GetShiftDecimal": Function((_P, _N, _P), _get_shift),
    "GetShiftFraction": Function((_P, _N, _P, _P), _get_shift_fraction),
    "SetIntervalDecimal": _set_decimals("set-interval-decimal"),
    "SetShiftDecimal": _set_decimals("set-shift-decimal"),
    "SetIntervalFraction": _set_fractions("set-interval-fraction"),
    "SetShiftFraction": _set_fractions("set-shift-fraction"),
    "GetFMUState": Function((_P,), _get_state),
    "SetFMUState": Function((_P,), _set_state),
    "FreeFMUState": Function((_P,), _free_state),
    "SerializedFMUStateSize": Function((_P, _P), _state_size),
    "SerializeFMUState": Function((_P, _P, _N), _write_state),
    "DeserializeFMUState": Function((_P, _N, _P), _read_state),
    "GetDirectionalDerivative": Function((_P, _N, _P, _N, _P, _N, _P, _N), _directional),
}
