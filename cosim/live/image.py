"""A plan in the memory of WebAssembly: structs of the native engine, copied with other addresses.

An image is the content of one block of memory that the page reserves, and a list of the places in
it that hold addresses, which the page fills in: of the block itself, of functions and of instances.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cosim.base.errors import ScenarioError
from cosim.engine.arrays import rows_of
from cosim.live.layout import layout
from cosim.native import structs

#: What a pointer of a struct points to, and how many of them; the struct is the argument.
Counted = tuple[Any, Callable[[Any], int]]


class LiveError(ScenarioError):
    """A scenario cannot be computed in a page."""


def _one(_: Any) -> int:
    return 1


#: By struct and member, for arrays that the struct itself counts.
ARRAYS: Mapping[tuple[type[c.Structure], str], Counted] = {
    (structs.EngineStruct, "segments"): (structs.SegmentStruct, lambda x: x.n_segments),
    (structs.EngineStruct, "columns"): (structs.ColumnsStruct, _one),
    (structs.ColumnsStruct, "stretches"): (structs.StretchStruct, lambda x: x.n_stretches),
    (structs.UnitStruct, "inputs"): (c.c_uint32, lambda x: x.n_inputs),
    (structs.UnitStruct, "outputs"): (c.c_uint32, lambda x: x.n_outputs),
    (structs.UnitStruct, "typed"): (structs.TypedStruct, _one),
    (structs.TypedStruct, "inputs"): (structs.AccessStruct, lambda x: x.n_inputs),
    (structs.TypedStruct, "outputs"): (structs.AccessStruct, lambda x: x.n_outputs),
    (structs.TypedStruct, "discrete"): (structs.AccessStruct, lambda x: x.n_discrete),
    (structs.AccessStruct, "references"): (c.c_uint32, lambda x: x.n_references),
    (structs.AccessStruct, "places"): (c.c_int64, lambda x: x.count),
    (structs.AccessStruct, "held"): (c.c_double, lambda x: x.count),
    (structs.StartCallStruct, "references"): (c.c_uint32, lambda x: x.n_references),
    (structs.StartStruct, "components"): (structs.StartingStruct, lambda x: x.n),
}
#: Members that hold the address of a function of an FMU.
FUNCTIONS = frozenset({
    (structs.UnitStruct, "set"), (structs.UnitStruct, "step"), (structs.UnitStruct, "get"),
    (structs.UnitStruct, "steps"), (structs.AccessStruct, "call"),
    (structs.StartCallStruct, "function"), (structs.TypedStruct, "enter_event"),
    (structs.TypedStruct, "update"), (structs.TypedStruct, "enter_step"),
})  # fmt: skip


@dataclass
class Image:
    """Blocks of memory, one after the other, and what has to be filled in when it has a place.

    `inside`: (place, target) of addresses within the image. `functions`: (place, module, name).
    `instances`, `values`, `logs`: (place, number of the component). `stops`: places of the address
    of the engine's flag. `known`: names of functions by native address: (module, name); `handles`,
    `log_numbers`: numbers of components by the native addresses of instances and logs; `shared`:
    places of what several components have in common, by native address.
    """

    known: dict[int, tuple[str, str]] = field(default_factory=dict)
    handles: dict[int, int] = field(default_factory=dict)
    log_numbers: dict[int, int] = field(default_factory=dict)
    inside: list[tuple[int, int]] = field(default_factory=list)
    functions: list[tuple[int, str, str]] = field(default_factory=list)
    instances: list[tuple[int, int]] = field(default_factory=list)
    values: list[tuple[int, int]] = field(default_factory=list)
    logs: list[tuple[int, int]] = field(default_factory=list)
    stops: list[int] = field(default_factory=list)
    shared: dict[int, int] = field(default_factory=dict)
    _content: bytearray = field(default_factory=bytearray)
    _copied: dict[tuple[int, int], int] = field(default_factory=dict)

    def content(self) -> bytes:
        """All blocks, in whole words of 8 bytes."""
        return bytes(self._content) + bytes(-len(self._content) % 8)

    def place(self, data: bytes | NDArray[Any], align: int = 8) -> int:
        """Add a block; where it begins."""
        self._content += bytes(-len(self._content) % align)
        at = len(self._content)
        self._content += data if isinstance(data, bytes) else data.tobytes()
        return at

    def reserve(self, size: int) -> int:
        """Add a block of zeros, `size` bytes; where it begins."""
        return self.place(bytes(size))

    def point(self, place: int, target: int) -> None:
        """Let the address at `place` be that of the block at `target`."""
        self.inside.append((place, target))

    def write(self, place: int, values: NDArray[Any]) -> None:
        """Write numbers at a place."""
        data = values.tobytes()
        self._content[place : place + len(data)] = data

    def array(self, kind: Any, rows: NDArray[np.void]) -> int:
        """Add structs, (n,) as the native engine has them, without their addresses."""
        found, native = layout(kind), rows
        made = np.zeros(len(rows), found.dtype)
        for name, member in found.fields.items():
            if not member.pointer:
                made[name] = native[name]
        return self.place(made, found.align)

    def copied(self, kind: Any, address: int, count: int) -> int:
        """Add `count` values or structs at a native address, with all they point to, once."""
        key = address, count * c.sizeof(kind)
        if key not in self._copied:
            if isinstance(kind, type) and issubclass(kind, c.Structure):
                self._copied[key] = self._structs(kind, address, count)
            else:
                self._copied[key] = self.place(c.string_at(address, key[1]))
        return self._copied[key]

    def _structs(self, kind: type[c.Structure], address: int, count: int) -> int:
        array = (kind * count).from_address(address)
        rows = rows_of(array)
        at, size = self.array(kind, rows), layout(kind).size
        for i, struct in enumerate(array):
            self.members(struct, at + i * size)
        return at

    def members(self, struct: Any, at: int) -> None:
        """Fill in the addresses of a struct that stands at `at`. Raises LiveError."""
        kind: Any = type(struct)
        for name, member in layout(kind).fields.items():
            value = getattr(struct, name) if member.pointer else None
            if not value:
                continue
            place = at + member.offset
            if (kind, name) in FUNCTIONS:
                self.functions.append((place, *self._function(value)))
            elif (kind, name) in ARRAYS:
                of, counted = ARRAYS[kind, name]
                self.point(place, self.copied(of, value, max(1, counted(struct))))
            elif (kind, name) == (structs.AccessStruct, "buffer"):
                self.point(place, self.reserve(8 * struct.count))
            elif (kind, name) == (structs.TypedStruct, "stop"):
                self.stops.append(place)
            elif (kind, name) == (structs.TypedStruct, "log"):
                self.logs.append((place, self.log_numbers[value]))
            elif name == "instance":
                self.instances.append((place, self.handles[value]))
            elif (kind, name) == (structs.UnitStruct, "values"):
                self.values.append((place, self.handles[struct.instance]))
            elif (kind, name) not in _ELSEWHERE:
                raise LiveError(f"{kind.__name__}.{name} has no counterpart in a page")

    def _function(self, address: int) -> tuple[str, str]:
        return self.known[address]


#: Members that the caller fills in.
_ELSEWHERE = frozenset({
    *((structs.EngineStruct, name) for name in (
        "operations", "units", "links", "senders", "players", "gates", "signals")),
    *((structs.LinkStruct, name) for name in ("sender", "table", "initial")),
    (structs.SenderStruct, "history"), (structs.PlayerStruct, "values"),
    *((structs.StartingStruct, name) for name in ("kind", "row")),
    *((structs.StartStruct, name) for name in (
        "order", "bringing", "fed", "feeds", "first_fed", "signals", "known", "before", "stale",
        "waiting", "asked", "unsettled", "room")),
})  # fmt: skip
