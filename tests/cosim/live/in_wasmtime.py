"""A bundle computed by wasmtime: the run that ``engine.js`` computes, written once more.

It computes a run as it was bundled, to its end; what a run may refuse fails an assertion here.
"""

from __future__ import annotations

import base64
import ctypes
import struct
import zlib
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import numpy as np
import wasmtime as w

from cosim.native.enums import EngineResult, Stage, StartResult

_CHUNK = 8192


def block(text: str) -> bytes:
    """A block of a bundle."""
    return zlib.decompress(base64.b64decode(text))


def _unsigned(data: bytes, at: int) -> tuple[int, int]:
    """A number in LEB128, and the place behind it."""
    value = shift = 0
    while True:
        value |= (data[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 128:
            return value, at


def _needs(code: bytes) -> tuple[int, int, int]:
    """Bytes of memory, their alignment and entries of the table: of the first section, dylink.0."""
    assert code[8] == 0, "the first section is custom"
    _, at = _unsigned(code, 9)
    length, at = _unsigned(code, at)
    assert code[at : at + length] == b"dylink.0"
    assert code[at + length] == 1, "the first part is WASM_DYLINK_MEM_INFO"
    _, at = _unsigned(code, at + length + 1)
    memory, at = _unsigned(code, at)
    align, at = _unsigned(code, at)
    table, _ = _unsigned(code, at)
    return memory, 1 << align, table


class Machine:
    """The engine with its memory, and the libraries of the models in it."""

    def __init__(self, bundle: Mapping[str, Any]) -> None:
        self.store = w.Store(w.Engine())
        module = w.Module(self.store.engine, block(bundle["engine"]))
        self.core = dict(self._instance(module, {}).items())
        self.memory, self.table = self.core["memory"], self.core["__indirect_function_table"]
        self.call(self.core, "_initialize")
        self.modules = {name: self._library(block(t)) for name, t in bundle["modules"].items()}
        self._places: dict[tuple[str, str], int] = {}

    def _instance(self, module: w.Module, given: Mapping[str, Any]) -> Any:
        """An instance; functions that are not given trap."""
        imports = []
        for asked in module.imports:
            found = given.get(asked.name or "")
            if found is None:
                assert isinstance(asked.type, w.FuncType), f"{asked.name} is missing"
                found = w.Func(self.store, asked.type, _refused(f"{asked.name} was called"))
            imports.append(found)
        return w.Instance(self.store, module, imports).exports(self.store)

    def _library(self, code: bytes) -> dict[str, Any]:
        """The functions of a model, loaded into the memory of the engine."""
        memory, align, table = _needs(code)
        base = -(-self.reserve(memory + align) // align) * align
        constant = w.GlobalType(w.ValType.i32(), False)
        given = {
            **self.core,
            "__memory_base": w.Global(self.store, constant, w.Val.i32(base)),
            "__table_base": w.Global(
                self.store, constant, w.Val.i32(self.table.grow(self.store, table, None))
            ),
        }
        found = dict(self._instance(w.Module(self.store.engine, code), given).items())
        for name in ("__wasm_apply_data_relocs", "__wasm_call_ctors"):
            if name in found:
                self.call(found, name)
        return found

    def call(self, functions: Mapping[str, Any], name: str, *given: float) -> Any:
        """Call a function of a module."""
        return functions[name](self.store, *given)

    def index(self, name: str, module: str = "") -> int:
        """The place in the table of a function of a module, or of the engine."""
        if (module, name) not in self._places:
            function = (self.modules[module] if module else self.core)[name]
            self._places[module, name] = self.table.grow(self.store, 1, function)
        return self._places[module, name]

    def reserve(self, size: int) -> int:
        """The address of zeroed memory."""
        at: int = self.call(self.core, "calloc", 1, max(8, size))
        assert at > 0, f"no memory for {size} bytes"
        return at

    def put(self, data: bytes, at: int = 0) -> int:
        """Write bytes, into memory of their own if no place is given; returns their address."""
        at = at or self.reserve(len(data))
        self.memory.write(self.store, data, at)
        return at

    def view(self, at: int, count: int, kind: str) -> np.ndarray[Any, np.dtype[Any]]:
        """Numbers in memory, until it grows."""
        data = self.memory.data_ptr(self.store)
        size = count * np.dtype(kind).itemsize
        assert at + size <= self.memory.data_len(self.store)
        raw = (ctypes.c_ubyte * size).from_address(ctypes.addressof(data.contents) + at)
        return np.ctypeslib.as_array(raw).view(kind)


def _refused(text: str) -> Any:
    def call(*_: Any) -> None:
        raise AssertionError(text)

    return call


class Simulator:
    """A run of a bundle in a machine."""

    def __init__(self, bundle: dict[str, Any]) -> None:
        self.bundle, self.machine = bundle, Machine(bundle)
        self.base = self.machine.put(block(bundle["image"]))
        self.handles: list[int] = []
        self._load()

    def _load(self) -> None:
        """Instances, and all addresses in the image."""
        bundle, machine = self.bundle, self.machine
        logs = [self._instantiate(component) for component in bundle["components"]]
        for at, to in np.frombuffer(block(bundle["inside"]), "<u4").reshape(-1, 2):
            self._address(at, self.base + int(to))
        for one in bundle["functions"]:
            for at in one["places"]:
                self._address(at, machine.index(one["name"], one["module"]))
        for at, i in bundle["logs"]:
            self._address(at, logs[i])
        for at, i in bundle["instances"]:
            self._address(at, self.handles[i])
        for at, i in bundle["values"]:
            one = bundle["components"][i]
            functions = machine.modules[one["module"]]
            self._address(at, machine.call(functions, f"fmi{one['fmi']}_values", self.handles[i]))

    def _address(self, at: int, value: int) -> None:
        self.machine.put(struct.pack("<I", value), self.base + int(at))

    def _instantiate(self, component: Mapping[str, Any]) -> int:
        """Instantiate a component; returns the address of its log."""
        machine = self.machine
        calls = machine.modules[component["module"]]
        log = machine.reserve(self.bundle["log"]["size"])
        name, token, none = (
            machine.put(text.encode() + b"\0")
            for text in (component["name"], component["token"], "")
        )
        machine.call(machine.core, "engine_log_open", name, log)
        if component["fmi"] == 2:
            three = [machine.index(one) for one in ("engine_log2", "calloc", "free")]
            callbacks = machine.put(struct.pack("<5I", *three, 0, log))
            given: tuple[int, ...] = (name, 1, token, none, callbacks, 0, 0)
            handle = machine.call(calls, "fmi2Instantiate", *given)
        else:
            given = (name, token, none, *6 * [0], log, machine.index("engine_log3"), 0)
            handle = machine.call(calls, "fmi3InstantiateCoSimulation", *given)
        assert handle > 0, f"{component['name']} does not start"
        self.handles.append(handle)
        return log

    def _at(self, name: str, member: str, i: int = 0) -> int:
        """The address of a member of the struct `i` of its kind."""
        layout, first = self.bundle["layouts"][name], self.base + self.bundle["places"][name]
        return int(first + i * layout["size"] + layout["members"][member])

    def _whole(self, name: str, member: str, value: int | None = None) -> int:
        found = self.machine.view(self._at(name, member), 1, "<i8")
        if value is not None:
            found[0] = value
        return int(found[0])

    def _engine(self, name: str, of: str, *given: int) -> Any:
        """Call a function of the engine, whose first argument is the place of a struct."""
        place = self.base + self.bundle["places"][of]
        return self.machine.call(self.machine.core, name, place, *given)

    def _start(self) -> None:
        """The start: as ``cosim.engine.initialization``."""
        n, at = len(self.bundle["components"]), 0
        assert self._call_start("engine_start", 0, Stage.ENTER) == StartResult.DONE
        self._settle()
        while at < n:
            result = self._call_start("engine_start", at, Stage.LEAVE)
            at = self._whole("start", "at")
            assert result in (StartResult.DONE, StartResult.CHANGED)
            if result == StartResult.CHANGED:
                self._settle()
        signals = self._signals()
        for to, signal, count in self.bundle["copies"]:
            self.machine.view(self.base + to, count, "<f8")[:] = signals[signal : signal + count]

    def _call_start(self, name: str, at: int, *stage: int) -> int:
        for member, value in {"n": len(self.bundle["components"]), "at": at, "call": 0}.items():
            self._whole("start", member, value)
        return int(self._engine(name, "start", *stage))

    def _settle(self) -> None:
        self._whole("start", "passes", 0)
        assert self._call_start("engine_settle", -1) == StartResult.DONE

    def _signals(self) -> np.ndarray:
        at = self.base + self.bundle["places"]["signals"]
        return self.machine.view(at, self.bundle["n_signals"], "<f8")

    def _tables(self) -> None:
        """Rows of links, drawn beforehand or here, and values of inputs over time."""
        bundle, machine = self.bundle, self.machine
        rows = {one["link"]: block(one["rows"]) for one in bundle["frozen"]}
        rows |= {one["link"]: bytes(4 * one["rows"]) for one in bundle["drawn"]}
        places = {link: machine.put(data) for link, data in rows.items()}
        for link, at in places.items():
            machine.put(struct.pack("<I", at), self._at("links", "table", link))
            machine.put(struct.pack("<q", 0), self._at("links", "row", link))
            machine.put(struct.pack("<q", len(rows[link]) // 4), self._at("links", "rows", link))
        for i, one in enumerate(bundle["drawn"]):
            machine.put(struct.pack("<I", places[one["link"]]), self._at("tables", "rows", i))
            machine.put(struct.pack("<q", one["rows"]), self._at("tables", "n", i))
        if n := len(bundle["drawn"]):
            words, ends = (self.base + bundle["places"][name] for name in ("words", "ends"))
            self._engine("tables_seed", "tables", n, words, ends)
            assert self._engine("tables_rows", "tables", n) < 0
        for i, values in enumerate(block(text) for text in bundle["played"]):
            machine.put(struct.pack("<I", machine.put(values)), self._at("players", "values", i))
            machine.put(struct.pack("<q", 0), self._at("players", "row", i))
            machine.put(struct.pack("<q", len(values) // 8), self._at("players", "rows", i))

    def run(self) -> str:
        """The digest of the run, as :func:`cosim.live.digest` computes it."""
        bundle, width = self.bundle, len(self.bundle["columns"])
        self._start()
        self._tables()
        buffer = self.machine.reserve(8 * width * _CHUNK)
        kept = []
        self._whole("engine", "every", 1)
        while (first := self._whole("engine", "tick")) < bundle["ticks"]:
            self.machine.put(struct.pack("<I", buffer), self._at("engine", "record"))
            self._whole("engine", "row", 0)
            n = min(_CHUNK, bundle["ticks"] - first)
            assert self._engine("engine_run", "engine", n) == EngineResult.OK
            assert self._whole("engine", "row") == self._whole("engine", "tick") - first == n
            found = self.machine.view(buffer, n * width, "<f8").reshape(n, width)
            kept.append(found[-first % bundle["every"] :: bundle["every"]].copy())
        rows = np.vstack([*kept, self._signals()[bundle["columns"]]])
        ticks = np.append(np.arange(0, bundle["ticks"], bundle["every"]), bundle["ticks"])
        rows[np.isnan(rows)] = np.nan
        digest = sha256(b"t\0" + (bundle["start"] + ticks * bundle["h"]).astype("<f8").tobytes())
        names = [name for signal in bundle["signals"] for name in signal["names"]]
        for name, column in zip(names, rows.T, strict=True):
            digest.update(f"{name}\0".encode() + column.tobytes())
        return digest.hexdigest()
