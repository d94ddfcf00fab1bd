"""The process of an isolated FMU: it executes requests of :mod:`cosim.fmi.isolated` until its end.

It contains one FMU. Its memory is shared: the log first, so that it survives a crash, then the
signals.
"""

from __future__ import annotations

import ctypes as c
import mmap
import os
import pickle
import signal
import struct
import sys
from typing import Any

from cosim.base.errors import FmuError
from cosim.fmi.instances import instantiate
from cosim.fmi.layout import StepLayout, bind, late_clock_ticks
from cosim.fmi.library import Instance, Setup
from cosim.native import fmu_log, structs

STEP, ANSWER = struct.Struct("<cdq"), struct.Struct("<cqqq")


class Worker:
    """One FMU and the memory shared with whoever steps it; `signals` start at `offset` bytes."""

    def __init__(self, memory: mmap.mmap, offset: int) -> None:
        self._memory = memory
        self._signals = c.addressof(c.c_char.from_buffer(memory, offset))
        self._instance: Instance | None = None
        self._alive: list[Any] = []
        self._unit = structs.UnitStruct()
        self._status, self._failed = c.c_int32(), c.c_int32()
        self._step = structs.library().engine_unit

    def ready(self) -> None:
        """The process runs."""

    def start(self, setup: Setup, room: int, limit: int) -> None:
        """Instantiate; `room`: bytes of the log, `limit`: MB of memory more than now, 0 for any."""
        if limit:
            _limit(limit)
        self._instance = instantiate(setup, fmu_log.log(self._memory, room))

    def bind(self, layout: StepLayout) -> None:
        """Get ready to step."""
        assert self._instance is not None
        self._unit = bind(self._instance, layout, self._alive)

    def late_clock_ticks(self) -> tuple[int, float]:
        """Number of late clock ticks, and their greatest delay (s)."""
        return late_clock_ticks(self._unit)

    def step(self, t: float, hit: int) -> tuple[int, int, int]:
        """Step; returns engine.c's result, the FMU's status, and the signal at fault."""
        result = self._step(
            c.byref(self._unit), self._signals, t, hit, c.byref(self._status), c.byref(self._failed)
        )
        assert self._instance is not None
        self._instance.returned(self._status.value)
        return result, self._status.value, self._failed.value

    def reached(self) -> float:
        """The time (s) at which a step ended the simulation."""
        return float(self._unit.reached)

    def call(self, name: str, arguments: tuple[Any, ...]) -> Any:
        """One member of this, or of the instance."""
        if name in ("ready", "start", "bind", "late_clock_ticks", "reached"):
            return getattr(self, name)(*arguments)
        return getattr(self._instance, name)(*arguments)


def _limit(megabytes: int) -> None:
    import resource

    with open("/proc/self/statm", encoding="ascii") as file:
        now = int(file.read().split()[0]) * mmap.PAGESIZE
    most = now + megabytes * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main(descriptor: int, size: int, offset: int) -> None:
    """Serve until the other end closes. What the FMU prints goes where errors go."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever steps decides when to stop
    from multiprocessing.connection import Connection

    asked, answers = Connection(os.dup(0), writable=False), Connection(os.dup(1), readable=False)
    os.dup2(2, 1)
    os.close(0)
    worker = Worker(mmap.mmap(descriptor, size), offset)
    while True:
        try:
            message = asked.recv_bytes()
        except EOFError:
            os._exit(0)  # an FMU's own clean-up could wait for ever
        if message[:1] == b"s":
            _, t, hit = STEP.unpack(message)
            answers.send_bytes(ANSWER.pack(b"s", *worker.step(t, hit)))
        else:
            answers.send_bytes(_answer(worker, message[1:]))


def _answer(worker: Worker, message: bytes) -> bytes:
    try:
        name, arguments = pickle.loads(message)
        return b"r" + pickle.dumps(worker.call(name, arguments))
    except FmuError as error:
        return b"e" + str(error).encode()
    except Exception as error:
        return b"e" + f"{type(error).__name__}: {error}".encode()


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:4]))
