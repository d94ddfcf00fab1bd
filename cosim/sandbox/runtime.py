"""One instance of an FMU's component in wasmtime: its memory, its calls, and why one failed.

It has no files, no network, no environment and no arguments; of the host it gets what the standard
imports, and of WASI the clock, random numbers, and an exit that ends the FMU only.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import wasmtime
from wasmtime import _bindings as bindings
from wasmtime import component as components

from cosim.base.errors import FmuError
from cosim.sandbox.machine import EPOCH, EPOCHS, compiled, engine

#: Names of fmi3Status, in its order.
STATUSES = ("ok", "warning", "discard", "error", "fatal")
CALLBACKS = "fmi:fmi3/callbacks@3.0.0"
_INTERMEDIATE = "fmi:fmi3/intermediate-update-callbacks@3.0.0"
_RESOURCES = "fmi:fmi3/resource-dir-callbacks@3.0.0"
_CO_SIMULATION = "fmi:fmi3/co-simulation@3.0.0"
_METHOD = "[method]co-simulation-instance."
_INSTANTIATE = "[static]co-simulation-instance.instantiate-co-simulation"
#: Seconds that a call may still take when the run is asked to stop.
GRACE = 1.0
#: MB of memory that an FMU may have where nothing is said.
MEMORY = 1024
_LEAVING = "tried to end the process"
#: What wasmtime says of a trap, and what an FMU did then.
_TRAPS = {
    "out of bounds memory access": "touched memory that is not its own",
    "call stack exhausted": "used up its stack",
    "unreachable": "gave up: it called abort or trapped itself",
    "undefined element": "called a function that is none",
    "uninitialized element": "called a function that is none",
    "indirect call type mismatch": "called a function as another type",
    "integer divide by zero": "divided an integer by zero",
}


_DEADLINE = bindings._wasmtime_store_epoch_deadline_callback.argtypes[1]
_NO_FINALIZER = bindings._wasmtime_store_epoch_deadline_callback.argtypes[3]()


class Limits(NamedTuple):
    """Seconds that one call may take, and MB of memory (0: :data:`MEMORY`)."""

    patience: float
    memory: int = 0


class Trap(Exception):
    """A call that did not return; the text follows the name of the function."""


class Callbacks(NamedTuple):
    """The host of an FMU, which it may ask to log (status, category, text), and for a file of its
    resources.
    """

    log: Callable[[int, str, str], None]
    resources: Path


class Guest:
    """One instance; :meth:`instantiate` has to be first. Raises FmuError where it is of another
    world.

    `trapped`: what it did in the call after which nothing is called any more; "": nothing.
    """

    def __init__(self, path: Path, limits: Limits, callbacks: Callbacks) -> None:
        self.trapped = ""
        self.stop = 0
        self._limits, self._callbacks = limits, callbacks
        self._began, self._stopped, self._cause = 0, -1, ""
        component = compiled(path)
        self._store = store = wasmtime.Store(engine())
        store.set_limits(memory_size=(limits.memory or MEMORY) << 20)
        self._deadline = _DEADLINE(self._late)
        bindings.wasmtime_store_epoch_deadline_callback(
            store.ptr(), self._deadline, None, _NO_FINALIZER
        )
        store.set_epoch_deadline(1)
        EPOCHS.begin()
        self._open = True
        try:
            self._instance = self._link(component)
            self._exports = self._instance.get_export_index(store, _CO_SIMULATION)
            if self._exports is None:
                raise FmuError(f"{path.name} does not export {_CO_SIMULATION}")
        except wasmtime.WasmtimeError as error:
            self.close()
            raise FmuError(f"{path.name} cannot be instantiated: {self._why(error)}") from None
        except FmuError:
            self.close()
            raise
        self._functions: dict[str, components.Func] = {}
        self._resource: Any = None

    def _link(self, component: components.Component) -> components.Instance:
        store, linker = self._store, components.Linker(engine())
        imported = component.type.imports(engine())
        if any(name.startswith("wasi:") for name in imported):
            store.set_wasi(wasmtime.WasiConfig())
            linker.add_wasip2()
        given: dict[str, dict[str, Callable[..., Any]]] = {
            CALLBACKS: {
                "log-message": self._log,
                "clock-update": _nothing,
                "lock-preemption": _nothing, "unlock-preemption": _nothing,
            },
            _INTERMEDIATE: {"intermediate-update": lambda *_: (False, 0.0)},
            _RESOURCES: {"read-file": self._read},
        }  # fmt: skip
        with linker.root() as root:
            for name, functions in given.items():
                if name in imported:
                    with root.add_instance(name) as instance:
                        for function, call in functions.items():
                            instance.add_func(function, call)
        self._began = EPOCHS.now
        return linker.instantiate(store, component)

    def _log(self, _: Any, name: str, status: str, category: str, message: str) -> None:
        if not name and message.startswith(_LEAVING):  # of fmus/c/wasm/system.c, which then traps
            self._cause = message
        else:
            self._callbacks.log(STATUSES.index(status), category, message)

    def _read(self, _: Any, path: str) -> bytes | str:
        folder = self._callbacks.resources.resolve()
        found = (folder / path).resolve()
        try:
            return found.read_bytes() if found.is_relative_to(folder) else "not in resources"
        except OSError as error:
            return error.strerror or "cannot be read"

    def _late(self, _: Any, __: Any, delta: Any, kind: Any) -> int:
        """Called once an epoch in a call that lasts: 0, or an error that ends it."""
        try:
            delta[0], kind[0] = 1, 0  # look again after the next epoch
            now = EPOCHS.now
            if (
                self.stop
                and self._stopped < self._began
                and c.c_int32.from_address(self.stop).value
            ):
                self._stopped = now
            if self._stopped >= self._began and (now - self._stopped) * EPOCH >= GRACE:
                self._cause = "was stopped and was ended"
            elif (now - self._began) * EPOCH >= self._limits.patience:
                self._cause = f"took longer than {self._limits.patience:g} s and was ended"
            else:
                return 0
        except BaseException:  # a second Ctrl-C
            self._cause = "was stopped and was ended"
        error = wasmtime.WasmtimeError("late")._consume()
        return int(c.cast(error, c.c_void_p).value or 0)

    def _why(self, error: Exception) -> str:
        """Tell what the FMU did in a call that failed."""
        cause, self._cause = self._cause, ""
        if cause:
            return cause
        if isinstance(error, wasmtime.ExitTrap):
            return f"{_LEAVING}, with exit code {error.code}"
        text = str(error)
        for said, did in _TRAPS.items():
            if said in text:
                return did
        last = text.rpartition("wasm trap:")[2].strip() or type(error).__name__
        return f"failed in its sandbox: {last.splitlines()[0]}"

    # ---- calls -------------------------------------------------------------------------------

    def function(self, method: str) -> components.Func:
        """A method of the instance. Raises Trap where it is missing."""
        found = self._functions.get(method)
        if found is None:
            name = method if method.startswith("[") else _METHOD + method
            index = self._instance.get_export_index(self._store, name, self._exports)
            found = None if index is None else self._instance.get_func(self._store, index)
            if found is None:
                raise Trap(f"is missing: the component does not export {name}")
            self._functions[method] = found
        return found

    def instantiate(self, values: dict[str, Any]) -> bool:
        """Make the instance, of which there is one; whether the FMU agreed.

        `values`: parameters by name; those that a draft of the standard lacks are left out.
        """
        new = self.function(_INSTANTIATE)
        given = [values[name] for name, _ in new.type(self._store).params]
        self._resource = self._guarded(lambda: new(self._store, *given))
        return self._resource is not None

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method; returns its result. Raises Trap."""
        function = self.function(method)
        return self._guarded(lambda: function(self._store, self._resource, *arguments))

    def raw(self, function: Any, arguments: Any, count: int, result: Any) -> None:
        """Call a method with values in memory, of which the first is :meth:`this`. Raises Trap."""
        self._began = EPOCHS.now
        error = bindings.wasmtime_component_func_call(
            function, self._store._context(), arguments, count, result, 1
        )
        if error:
            raise Trap(self._why(wasmtime.WasmtimeError._from_ptr(error)))

    def this(self) -> Any:
        """The instance as a pointer, valid until :meth:`drop`."""
        return self._resource.ptr()

    def _guarded(self, call: Callable[[], Any]) -> Any:
        self._began = EPOCHS.now
        try:
            return call()
        except wasmtime.WasmtimeError as error:
            raise Trap(self._why(error)) from None

    def drop(self) -> None:
        """Free the instance of the FMU. Raises Trap."""
        resource, self._resource = self._resource, None
        if resource is not None:
            self._guarded(lambda: resource.drop(self._store))

    def close(self) -> None:
        """Give all its memory back; may be called twice."""
        if self._open:
            self._open = False
            self._resource = None
            self._store.close()
            EPOCHS.end()


def _nothing(_: Any) -> None:
    """Do nothing for call-backs that co-simulation without intermediate updates does not need."""
