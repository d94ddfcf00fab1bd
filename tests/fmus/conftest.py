"""An FMU's library called as an importer in C calls it: bare functions, and a log that listens."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from ctypes import Structure, byref, c_bool, c_char, c_double, c_int, c_size_t, c_uint32, c_void_p
from pathlib import Path
from typing import Any

import pytest

from fmus.build import toolchain
from fmus.build.kernel import library, load
from fmus.build.source import token
from fmus.model import Model

OK, DISCARD, ERROR = 0, 2, 3
MODES = ("instantiated", "initialization", "step", "failed", "terminated")

# fmi2CallbackLogger is variadic, which only C can be called as.
LISTENER = """
#include <stdarg.h>
#include <stdio.h>

#include "export.h"

typedef struct { int status; char name[32], category[32], text[600]; } Entry;
typedef struct { int count; Entry entries[32]; } Log;

static Entry *next(Log *log) { return &log->entries[log->count < 31 ? log->count++ : 31]; }

EXPORT void listen2(void *log, const char *name, int status, const char *category,
                    const char *format, ...) {
    Entry *entry = next(log);
    va_list arguments;
    va_start(arguments, format);
    entry->status = status;
    snprintf(entry->name, sizeof entry->name, "%s", name);
    snprintf(entry->category, sizeof entry->category, "%s", category);
    vsnprintf(entry->text, sizeof entry->text, format, arguments);
    va_end(arguments);
}

EXPORT void listen3(void *log, int status, const char *category, const char *text) {
    Entry *entry = next(log);
    entry->status = status;
    snprintf(entry->category, sizeof entry->category, "%s", category);
    snprintf(entry->text, sizeof entry->text, "%s", text);
}
"""


class Entry(Structure):
    _fields_ = [
        ("status", c_int),
        ("name", c_char * 32),
        ("category", c_char * 32),
        ("text", c_char * 600),
    ]


class Log(Structure):
    _fields_ = [("count", c_int), ("entries", Entry * 32)]

    def take(self) -> list[tuple[int, str, str]]:
        """(status, category, text) of what was logged since the last time."""
        found = [
            (e.status, e.category.decode(), e.text.decode()) for e in self.entries[: self.count]
        ]
        self.count = 0
        return found


class Callbacks2(Structure):
    _fields_ = [
        ("logger", c_void_p),
        ("allocateMemory", c_void_p),
        ("freeMemory", c_void_p),
        ("stepFinished", c_void_p),
        ("componentEnvironment", c_void_p),
    ]


class Driver:
    """One instance. ``driver("DoStep", 0.0, 1e-3)`` calls fmi2DoStep or fmi3DoStep on it."""

    def __init__(
        self,
        path: Path,
        listener: ctypes.CDLL,
        model: Model,
        version: str,
        *,
        name: bytes | None = b"it",
        guid: str | None = None,
        logging: bool = False,
        listening: bool = True,
    ) -> None:
        self.model, self.version, self.listening = model, version, listening
        self.library = load(path)
        self.log = Log()
        self._listener = listener
        self.handle = self._instantiate(name, (guid or token(model)).encode(), logging)

    def _instantiate(self, name: bytes | None, guid: bytes, logging: bool) -> int | None:
        log = c_void_p(ctypes.addressof(self.log))
        if self.version == "2.0":
            listen = ctypes.cast(self._listener.listen2, c_void_p) if self.listening else None
            self._callbacks = Callbacks2(listen, None, None, None, log)
            make = self.library.fmi2Instantiate
            make.restype = c_void_p
            return make(name, 1, guid, None, byref(self._callbacks), 0, int(logging))
        listen = ctypes.cast(self._listener.listen3, c_void_p) if self.listening else None
        make = self.library.fmi3InstantiateCoSimulation
        make.restype = c_void_p
        none, size = c_void_p(None), c_size_t(0)
        flags = [c_bool(False), c_bool(logging), c_bool(False), c_bool(True)]
        return make(name, guid, None, *flags, none, size, log, listen, none)

    def __call__(self, function: str, *arguments: Any) -> int:
        found = getattr(self.library, f"fmi{self.version[0]}{function}")
        given = [c_double(a) if isinstance(a, float) else a for a in arguments]
        return found(c_void_p(self.handle), *given)

    def free(self) -> None:
        free = getattr(self.library, f"fmi{self.version[0]}FreeInstance")
        free.restype = None
        free(c_void_p(self.handle))

    # --- life cycle --------------------------------------------------------------------------

    def enter(self, start: float = 0.0, stop: float | None = None) -> int:
        stops = [stop is not None, stop or 0.0]
        if self.version == "3.0":
            flags = [c_bool(False), c_double(0.0), c_double(start)]
            return self("EnterInitializationMode", *flags, c_bool(stops[0]), float(stops[1]))
        status = self("SetupExperiment", 0, 0.0, float(start), int(stops[0]), float(stops[1]))
        return status or self("EnterInitializationMode")

    def leave(self) -> int:
        return self("ExitInitializationMode")

    def step(self, t: float, h: float) -> int:
        if self.version == "2.0":
            return self("DoStep", float(t), float(h), 1)
        self.event, self.terminate, self.early = c_bool(True), c_bool(True), c_bool(True)
        self.last = c_double(-1.0)
        answers = [byref(x) for x in (self.event, self.terminate, self.early, self.last)]
        return self("DoStep", float(t), float(h), c_bool(True), *answers)

    def go_to(self, mode: str) -> None:
        """Bring a new instance to `mode`; "failed" is FMI 2.0's state after a discarded step."""
        if mode == "instantiated":
            return
        assert self.enter() == OK
        if mode == "initialization":
            return
        assert self.leave() == OK
        if mode == "failed":
            port = next(v for v in self.model.variables if v.causality == "input")
            assert self.set(port.name, [float("nan")] * port.size) == OK
            assert self.step(0.0, 1e-3) == DISCARD
        if mode == "terminated":
            assert self("Terminate") == OK
        self.log.take()

    # --- values ------------------------------------------------------------------------------

    def references(self, name: str) -> list[int]:
        """Value references of a variable: one a scalar in FMI 2.0, one in FMI 3.0."""
        offset = 0
        for number, variable in enumerate(self.model.variables):
            if variable.name == name:
                return (
                    [number]
                    if self.version == "3.0"
                    else list(range(offset, offset + variable.size))
                )
            offset += variable.size
        raise KeyError(name)

    def _of(self, name: str) -> tuple[str, Any, int]:
        variable = next(v for v in self.model.variables if v.name == name)
        types = {
            "2.0": {"real": ("Real", c_double), "integer": ("Integer", c_int)},
            "3.0": {"real": ("Float64", c_double), "integer": ("Int32", c_int)},
        }
        return (*types[self.version][variable.type], variable.size)

    def access(
        self, function: str, references: Sequence[int], values: Any, count: int | None = None
    ) -> int:
        """Get or set with references and an array as they are."""
        listed = (c_uint32 * len(references))(*references)
        extra = [] if self.version == "2.0" else [c_size_t(len(values) if count is None else count)]
        return self(function, listed, c_size_t(len(references)), values, *extra)

    def set(self, name: str, values: Sequence[float]) -> int:
        suffix, kind, size = self._of(name)
        cast = float if kind is c_double else int
        return self.access(f"Set{suffix}", self.references(name), (kind * size)(*map(cast, values)))

    def get(self, name: str) -> list[float]:
        suffix, kind, size = self._of(name)
        values = (kind * size)()
        status = self.access(f"Get{suffix}", self.references(name), values)
        assert status == OK, self.log.take()
        return list(values)

    def outputs(self) -> list[float]:
        """All outputs, one after the other."""
        return [x for port in self.model.outputs() for x in self.get(port.name)]

    # --- saved states ------------------------------------------------------------------------

    def suffix(self) -> str:
        return "FMUstate" if self.version == "2.0" else "FMUState"

    def save(self) -> c_void_p:
        state = c_void_p(None)
        assert self(f"Get{self.suffix()}", byref(state)) == OK
        return state

    def restore(self, state: c_void_p) -> int:
        return self(f"Set{self.suffix()}", state)

    def free_state(self, state: c_void_p) -> int:
        return self(f"Free{self.suffix()}", byref(state))

    def serialize(self, state: c_void_p) -> bytes:
        size = c_size_t(0)
        assert self(f"Serialized{self.suffix()}Size", state, byref(size)) == OK
        buffer = (c_char * size.value)()
        assert self(f"Serialize{self.suffix()}", state, buffer, size) == OK
        return buffer.raw

    def deserialize(self, data: bytes) -> tuple[int, c_void_p]:
        state = c_void_p(None)
        verb = "DeSerialize" if self.version == "2.0" else "Deserialize"
        buffer = (c_char * max(1, len(data))).from_buffer_copy(data or b"\0")
        status = self(f"{verb}{self.suffix()}", buffer, c_size_t(len(data)), byref(state))
        return status, state


@pytest.fixture(scope="session")
def listener(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """A logger for FMI 2.0 and 3.0 in C."""
    folder = tmp_path_factory.mktemp("listener")
    (folder / "listener.c").write_text(LISTENER)
    include = Path(toolchain.__file__).parents[1] / "c"
    output = folder / f"listener{toolchain.shared_suffix()}"
    toolchain.compile_shared([folder / "listener.c"], output, include=[include])
    return ctypes.CDLL(str(output))


Make = Callable[..., Driver]


@pytest.fixture
def drive(listener: ctypes.CDLL) -> Make:
    """``drive(model, version)``: a new instance of the model's FMU."""

    def make(model: Model, version: str, **options: Any) -> Driver:
        path = options.pop("path", None) or library(model)
        return Driver(path, listener, model, version, **options)

    return make
