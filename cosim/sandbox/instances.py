"""Instances of FMUs in WebAssembly by handle, and what a C function of FMI 3.0 is made of."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any, NamedTuple

from cosim.sandbox.runtime import STATUSES, Guest

OK, ERROR, FATAL = 0, 3, 4
#: Numbers of instances and of saved states.
HANDLES = count(1)


class Entry:
    """An instance with what its calls need: prepared arguments, and saved states by number."""

    def __init__(self, guest: Guest) -> None:
        self.guest = guest
        self.states: dict[int, bytes] = {}
        self.prepared: dict[tuple[str, bytes, int], Any] = {}
        self.texts: list[Any] = []  # what the last texts that were got are in
        self.stepping: Any = None


#: Instances by handle.
GUESTS: dict[int, Entry] = {}


def enter(guest: Guest) -> int:
    """The handle of a new instance."""
    handle = next(HANDLES)
    GUESTS[handle] = Entry(guest)
    return handle


class Function(NamedTuple):
    """A function by its `call`, with the entry and the arguments after the handle, of `types`."""

    types: tuple[Any, ...]
    call: Callable[..., int]


def status(name: str) -> int:
    """A status of the component as a number of fmi3Status."""
    return STATUSES.index(name)
