"""The process of an isolated FMU: it does what :mod:`cosim.fmi.isolation.remote` asks, to its end.

It contains one FMU, of which it has one instance at a time. Its memory is shared: the log first, so
that it survives a crash, then the mailbox and the signals.
"""

from __future__ import annotations

import ctypes as c
import mmap
import os
import signal
import sys
from typing import Any

from cosim.base.errors import FmuError
from cosim.base.interrupts import ENDING
from cosim.fmi.instances import instantiate
from cosim.fmi.isolation import protocol
from cosim.fmi.layout import StepLayout, bind, late_clock_ticks
from cosim.fmi.library import Instance, Setup
from cosim.native import fmu_log, structs
from cosim.native.shared import library
from cosim.native.structs import MailboxStruct, MailEndStruct


class Worker:
    """One FMU and the memory shared with whoever steps it; the mailbox is at `offset` bytes."""

    def __init__(self, memory: mmap.mmap, offset: int, bytes_wake: int) -> None:
        self._memory = memory
        self._box = MailboxStruct.from_buffer(memory, offset)
        self._instance: Instance | None = None
        self._alive: list[Any] = []
        self._unit = structs.UnitStruct()
        at = c.addressof(self._box)
        self.end = MailEndStruct(
            box=at,
            signals=at + c.sizeof(MailboxStruct),
            unit=c.addressof(self._unit),
            bytes=bytes_wake,
        )

    def ready(self) -> None:
        """The process runs."""

    def start(self, setup: Setup, room: int, limit: int) -> None:
        """Instantiate; `room`: bytes of the log, `limit`: MB of memory more than now, 0 for any."""
        if limit:
            _limit(limit)
        self._instance = instantiate(setup, fmu_log.log(self._memory, room))

    def rest(self) -> bool:
        """Free the FMU; whether this process may have another instance: nothing went wrong."""
        instance, self._instance = self._instance, None
        assert instance is not None
        instance.free()
        return not instance.broken

    def bind(self, layout: StepLayout) -> None:
        """Get ready to step."""
        assert self._instance is not None
        self._alive.clear()
        stop = c.addressof(self._box) + MailboxStruct.stop.offset
        self._unit = bind(self._instance, layout, self._alive, stop)
        self.end.unit = c.addressof(self._unit)

    def serialized(self) -> bytes:
        """The state of the FMU as bytes, after that of the structs which step it."""
        from cosim.native import memory  # NumPy: few runs save the state

        assert self._instance is not None
        stepped = [memory.save(piece) for piece in memory.unit_pieces("", self._unit)]
        return b"".join((*stepped, self._instance.serialized()))

    def set_serialized(self, data: bytes) -> None:
        """Go to a state that was serialized. Raises ValueError if it is too short."""
        from cosim.native import memory

        assert self._instance is not None
        for piece in memory.unit_pieces("", self._unit):
            end = memory.size(piece)
            memory.restore(piece, data[:end])
            data = data[end:]
        self._instance.set_serialized(data)

    def late_clock_ticks(self) -> tuple[int, float]:
        """Number of late clock ticks, and their greatest delay (s)."""
        return late_clock_ticks(self._unit)

    def call(self, message: bytes) -> bytes:
        """The answer to a message: what one member of this, or of the instance, returned."""
        try:
            name, arguments = protocol.requested(message)
            if self._instance is not None:
                self._instance.returned(self._box.status)  # of the last step: it may end all calls
            owner = self if protocol.is_own(name) else self._instance
            return protocol.answer(getattr(owner, name)(*arguments))
        except FmuError as error:
            return protocol.refusal(str(error))
        except Exception as error:
            return protocol.refusal(f"{type(error).__name__}: {error}")


def _limit(megabytes: int) -> None:
    import resource

    with open("/proc/self/statm", encoding="ascii") as file:
        now = int(file.read().split()[0]) * mmap.PAGESIZE
    most = now + megabytes * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def main(descriptor: int, size: int, offset: int, bytes_wake: int) -> None:
    """Serve until the other end closes. What the FMU prints goes where errors go."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)  # whoever steps decides when to stop
    from multiprocessing.connection import Connection

    asked, answers = Connection(os.dup(0), writable=False), Connection(os.dup(1), readable=False)
    os.dup2(2, 1)
    os.close(0)
    worker = Worker(mmap.mmap(descriptor, size), offset, bytes_wake)
    worker.end.incoming, worker.end.outgoing = asked.fileno(), answers.fileno()
    engine = library()
    while engine.engine_serve(c.byref(worker.end)):
        try:
            answer = worker.call(asked.recv_bytes())
            engine.engine_answer(c.byref(worker.end))
            answers.send_bytes(answer)
        except (EOFError, OSError):
            break
    os._exit(0)  # an FMU's own clean-up could wait for ever


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:5]))
