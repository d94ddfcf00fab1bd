"""A component as a shared library: the functions of FMI 3.0 by name, as function pointers."""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from cosim.sandbox.functions import FUNCTIONS
from cosim.sandbox.instances import ERROR, FATAL, GUESTS, Entry, Function, enter
from cosim.sandbox.runtime import Callbacks, Guest, Limits, Trap

_PREFIX = "fmi3"
_LOG = c.CFUNCTYPE(None, c.c_void_p, c.c_int, c.c_char_p, c.c_char_p)
_NEW = c.CFUNCTYPE(
    c.c_void_p, *(c.c_char_p,) * 3, *(c.c_bool,) * 4, c.c_void_p, c.c_size_t, *(c.c_void_p,) * 3
)
_FREE = c.CFUNCTYPE(None, c.c_void_p)


class SandboxLibrary:
    """The functions of a component's file; its instances have `limits`."""

    def __init__(self, path: Path, limits: Limits) -> None:
        self._path, self._limits = path, limits
        self._new = _NEW(self._instantiate)

    def __getitem__(self, name: str) -> Any:
        """A function by its name, as an object of its own whose types may be set.

        Raises AttributeError where the standard has none.
        """
        suffix = name.removeprefix(_PREFIX)
        if suffix == "InstantiateCoSimulation":
            found = self._new
        elif suffix == "FreeInstance":
            found = _FREE_INSTANCE
        elif suffix in FUNCTIONS and suffix != name:
            found = _pointer(suffix)
        else:
            raise AttributeError(name)
        return type(found)(c.cast(found, c.c_void_p).value or 0)

    def _instantiate(self, name: bytes, token: bytes, resources: bytes, *settings: Any) -> int:
        visible, logging, events, early, _, _, environment, log, _ = settings
        say = _LOG(log)

        def logged(status: int, category: str, text: str) -> None:
            say(environment, status, category.encode(), text.encode())

        callbacks = Callbacks(logged, Path(resources.decode()))
        guest = None
        try:
            guest = Guest(self._path, self._limits, callbacks)
            made = guest.instantiate({
                "instance-name": name.decode(), "instantiation-token": token.decode(),
                "resource-path": "", "visible": visible, "logging-on": logging,
                "event-mode-used": events, "early-return-allowed": early,
                "required-intermediate-variables": [],
            })  # fmt: skip
            if made:
                return enter(guest)
        except Exception as error:
            logged(ERROR, "logStatusError", str(error))
        if guest is not None:
            guest.close()
        return 0


def trapped(handle: int) -> str:
    """Tell what the instance of a handle did in the call that ended it; "": nothing."""
    entry = GUESTS.get(handle)
    return "" if entry is None else entry.guest.trapped


def watch(handle: int, stop: int) -> None:
    """Let calls of an instance end soon once the number at an address (int32) is not 0."""
    GUESTS[handle].guest.stop = stop


def discard(handle: int) -> None:
    """Forget an instance that must not be called any more, and give its memory back."""
    entry = GUESTS.pop(handle, None)
    if entry is not None:
        entry.guest.close()


def _free(handle: int) -> None:
    entry = GUESTS.pop(handle or 0, None)
    if entry is not None:
        try:
            if not entry.guest.trapped:
                entry.guest.drop()
        except Trap:
            pass
        entry.guest.close()


_FREE_INSTANCE = _FREE(_free)


@cache
def _pointer(suffix: str) -> Any:
    """The C function of a name."""
    function = FUNCTIONS[suffix]
    return c.CFUNCTYPE(c.c_int, c.c_void_p, *function.types)(_guarded(function))


def _guarded(function: Function) -> Callable[..., int]:
    call = function.call

    def guarded(handle: int, *arguments: Any) -> int:
        entry = GUESTS[handle]
        if entry.guest.trapped:
            return FATAL
        try:
            return call(entry, *arguments)
        except Trap as trap:
            return _fail(entry, str(trap))
        except BaseException as error:
            return _fail(entry, f"gave what no FMU gives: {type(error).__name__}: {error}")

    return guarded


def _fail(entry: Entry, did: str) -> int:
    """Nothing is called any more: a component that trapped cannot be entered again."""
    entry.guest.trapped = did
    entry.prepared.clear()
    entry.guest.close()
    return FATAL
