"""The one engine of wasmtime, the components that it has compiled, and its clock of epochs."""

from __future__ import annotations

import threading
from functools import cache
from pathlib import Path

import wasmtime
from wasmtime.component import Component

from cosim.base.errors import FmuError

#: Seconds of an epoch, after each of which a call that lasts is looked at.
EPOCH = 0.05


@cache
def engine() -> wasmtime.Engine:
    """The engine: calls end by epochs, and NaN has the same bits on every processor."""
    config = wasmtime.Config()
    config.epoch_interruption = True
    config.cranelift_nan_canonicalization = True
    config.wasm_threads = False
    config.parallel_compilation = False  # a process that forks leaves the threads behind
    return wasmtime.Engine(config)


class Epochs:
    """A thread that counts epochs while there are instances."""

    def __init__(self) -> None:
        self.now = 0
        self._users = 0
        self._lock = threading.Lock()
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    def begin(self) -> None:
        """One instance more."""
        with self._lock:
            self._users += 1
            if self._users > 1 and self._thread is not None and self._thread.is_alive():
                return
            self._end = threading.Event()
            run, name = (self._end,), "wasm epochs"
            self._thread = threading.Thread(target=self._run, args=run, daemon=True, name=name)
            self._thread.start()

    def end(self) -> None:
        """One instance less."""
        with self._lock:
            self._users -= 1
            if not self._users:
                self._end.set()

    def _run(self, end: threading.Event) -> None:
        counted = engine()
        while not end.wait(EPOCH):
            self.now += 1
            counted.increment_epoch()


#: The epochs of all instances.
EPOCHS = Epochs()


@cache
def compiled(path: Path) -> Component:
    """The component in a file, compiled once. Raises FmuError for a file that is none."""
    try:
        return Component(engine(), path.read_bytes())
    except (OSError, wasmtime.WasmtimeError) as error:
        raise FmuError(f"{path.name} is no WebAssembly component: {first_line(error)}") from None


def first_line(error: Exception) -> str:
    """The first line of what an exception says."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
