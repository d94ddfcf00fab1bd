"""The functions that step and that set and get numbers, without a Python object for each number.

Values of wasmtime have one size, so those of a list are each so many bytes apart: slices of
memoryviews copy them. The arguments of a call are prepared once for the variables it moves.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping
from typing import Any, NamedTuple

from wasmtime import _bindings as bindings
from wasmtime import _ffi as ffi

from cosim.sandbox.instances import OK, Entry, Function, status
from cosim.sandbox.runtime import Trap

_P, _N, _B, _D = c.c_void_p, c.c_size_t, c.c_bool, c.c_double
_ITEM = c.sizeof(bindings.wasmtime_component_val_t)
_PLACE = bindings.wasmtime_component_val_t.of.offset
_KINDS = {
    name: getattr(ffi, f"WASMTIME_COMPONENT_{name}").value
    for name in ("BOOL", "S8", "U8", "S16", "U16", "S32", "U32", "S64", "U64", "F32", "F64", "LIST",
                 "RESOURCE")
}  # fmt: skip


class _Type(NamedTuple):
    """A numeric type: its kind of value, its size in bytes, and its format in a memoryview."""

    kind: int
    size: int
    format: Any


_TYPES = {
    "Float32": _Type(_KINDS["F32"], 4, "f"), "Float64": _Type(_KINDS["F64"], 8, "d"),
    "Int8": _Type(_KINDS["S8"], 1, "b"), "Int16": _Type(_KINDS["S16"], 2, "h"),
    "Int32": _Type(_KINDS["S32"], 4, "i"), "Int64": _Type(_KINDS["S64"], 8, "q"),
    "UInt8": _Type(_KINDS["U8"], 1, "B"), "UInt16": _Type(_KINDS["U16"], 2, "H"),
    "UInt32": _Type(_KINDS["U32"], 4, "I"), "UInt64": _Type(_KINDS["U64"], 8, "Q"),
    "Boolean": _Type(_KINDS["BOOL"], 1, "B"),
}  # fmt: skip


class _PreparedCall:
    """The arguments of a call that gets or sets numbers of one type, of the same variables."""

    def __init__(self, entry: Entry, method: str, references: bytes, type_: _Type, n: int) -> None:
        value = bindings.wasmtime_component_val_t
        self.function = c.byref(entry.guest.function(method)._func)
        self.count = 3 if method.startswith("set-") else 2
        self.arguments, self.result = (value * 3)(), value()
        self.returned = c.byref(self.result)
        self.arguments[0].kind = _KINDS["RESOURCE"]
        self.arguments[0].of.resource = entry.guest.this()
        self._lists = [(value * max(1, size))() for size in (len(references) // 4, n)]
        items = memoryview(references).cast("I")
        kinds = (_KINDS["U32"], type_.kind)
        for place, (some, kind) in enumerate(zip(self._lists, kinds, strict=True), 1):
            self.arguments[place].kind = _KINDS["LIST"]
            self.arguments[place].of.list.size = (len(items), n)[place - 1]
            self.arguments[place].of.list.data = c.cast(some, c.POINTER(value))
            for one in some:
                one.kind = kind
        for one, reference in zip(self._lists[0], items, strict=False):
            one.of.u32 = reference
        self.type, self.n = type_, n
        first, step = _PLACE // type_.size, _ITEM // type_.size
        self.every = slice(first, None, step)
        self.view = memoryview(self._lists[1]).cast("B").cast(type_.format)
        self.raw = c.c_char * (type_.size * n)
        self.items = c.c_char * (_ITEM * n)


def _prepared(
    entry: Entry, method: str, type_: _Type, references: int, n: int, size: int
) -> _PreparedCall:
    raw = c.string_at(references, 4 * n)
    key = method, raw, size
    found = entry.prepared.get(key)
    if found is None:
        found = entry.prepared[key] = _PreparedCall(entry, method, raw, type_, size)
    return found


def _setter(name: str, type_: _Type) -> Function:
    method = f"set-{name}"

    def call(entry: Entry, references: int, n: int, values: int, size: int) -> int:
        x = _prepared(entry, method, type_, references, n, size)
        if size:
            given = memoryview(x.raw.from_address(values)).cast("B").cast(type_.format)
            x.view[x.every] = given
        entry.guest.raw(x.function, x.arguments, 3, x.returned)
        return _enumerated(x.result)

    return Function((_P, _N, _P, _N), call)


def _getter(name: str, type_: _Type) -> Function:
    method = f"get-{name}"

    def call(entry: Entry, references: int, n: int, values: int, size: int) -> int:
        x = _prepared(entry, method, type_, references, n, size)
        entry.guest.raw(x.function, x.arguments, 2, x.returned)
        result = x.result.of.result
        found = result.val.contents
        if not result.is_ok:
            return _enumerated(found)
        if found.of.list.size != size:
            raise Trap(f"returned {found.of.list.size} values, expected {size}")
        if size:
            data = c.cast(found.of.list.data, _P).value
            given = memoryview(x.items.from_address(data or 0)).cast("B").cast(type_.format)
            target = memoryview(x.raw.from_address(values)).cast("B").cast(type_.format)
            target[:] = given[x.every]
        return OK

    return Function((_P, _N, _P, _N), call)


def _enumerated(value: Any) -> int:
    name = value.of.enumeration
    return status(c.string_at(name.data, name.size).decode())


class _Stepping:
    """The arguments of ``do-step``."""

    def __init__(self, entry: Entry) -> None:
        value = bindings.wasmtime_component_val_t
        self.function = c.byref(entry.guest.function("do-step")._func)
        self.arguments, self.result = (value * 4)(), value()
        self.returned = c.byref(self.result)
        kinds = ("RESOURCE", "F64", "F64", "BOOL")
        for one, kind in zip(self.arguments, kinds, strict=True):
            one.kind = _KINDS[kind]
        self.arguments[0].of.resource = entry.guest.this()


def _do_step(entry: Entry, t: float, h: float, no_return: bool, *places: int) -> int:
    x = entry.stepping
    if x is None:
        x = entry.stepping = _Stepping(entry)
    x.arguments[1].of.f64, x.arguments[2].of.f64 = t, h
    x.arguments[3].of.boolean = no_return
    entry.guest.raw(x.function, x.arguments, 4, x.returned)
    result = x.result.of.result
    found = result.val.contents
    if not result.is_ok:
        return _enumerated(found)
    fields = found.of.record.data
    *flags, last = places
    c.c_double.from_address(last).value = fields[0].val.of.f64
    for field, address in enumerate(flags, 1):
        c.c_bool.from_address(address).value = fields[field].val.of.boolean
    return OK


#: The functions by name, without ``fmi3``.
NUMBERS: Mapping[str, Function] = {
    **{f"Set{name}": _setter(name.lower(), type_) for name, type_ in _TYPES.items()},
    **{f"Get{name}": _getter(name.lower(), type_) for name, type_ in _TYPES.items()},
    "DoStep": Function((_D, _D, _B, _P, _P, _P, _P), _do_step),
}
