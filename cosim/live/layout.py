"""Structs of C as WebAssembly has them: ``wasm32``, whose pointers have four bytes.

The members come from the same headers as those of the native engine
(:mod:`cosim.native.structs`); alignment is natural, as clang has it for ``wasm32-wasi``.
"""

from __future__ import annotations

import ctypes as c
from functools import cache
from typing import Any, NamedTuple

import numpy as np

#: Bytes of an address.
POINTER = 4


class MemberPlace(NamedTuple):
    """A member: where it begins, bytes; whether it is an address; its type in NumPy."""

    offset: int
    pointer: bool
    kind: np.dtype[Any]


class Layout(NamedTuple):
    """A struct: its size and alignment, bytes, and its members by name."""

    size: int
    align: int
    fields: dict[str, MemberPlace]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The struct for NumPy, little-endian; addresses are uint32."""
        return np.dtype({
            "names": list(self.fields),
            "formats": [field.kind for field in self.fields.values()],
            "offsets": [field.offset for field in self.fields.values()],
            "itemsize": self.size,
        })  # fmt: skip


@cache
def layout(struct: Any) -> Layout:
    """The layout of a struct in WebAssembly."""
    at, widest, fields = 0, 1, dict[str, MemberPlace]()
    for name, kind, *_ in struct._fields_:
        size, align, found = _element(kind)
        at = -(-at // align) * align
        fields[name] = MemberPlace(at, _is_pointer(kind), found)
        at, widest = at + size, max(widest, align)
    return Layout(-(-at // widest) * widest, widest, fields)


def _element(kind: Any) -> tuple[int, int, np.dtype[Any]]:
    """Size, alignment and NumPy's type of a member."""
    if _is_pointer(kind):
        return POINTER, POINTER, np.dtype("<u4")
    if issubclass(kind, c.Array):
        size, align, found = _element(kind._type_)
        return size * kind._length_, align, np.dtype((found, (kind._length_,)))
    if issubclass(kind, c.Structure):
        inner = layout(kind)
        return inner.size, inner.align, inner.dtype
    size = c.sizeof(kind)
    return size, size, np.dtype(kind).newbyteorder("<")


def _is_pointer(kind: Any) -> bool:
    return kind is c.c_void_p
