"""An FMU in a separate process: a crash or hang there does not affect the run's process.

Signals are in memory that both processes share, and ``mailbox.c`` asks for steps and waits for
them; the other calls are messages (:mod:`cosim.fmi.isolation.protocol`). The FMU is stepped by the
same C code as in this process, so the numbers are the same. Linux and macOS.
"""

from __future__ import annotations

import ctypes as c
import mmap
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

from cosim.base.errors import FmuError
from cosim.base.python import python_call
from cosim.fmi.file.binaries import is_sandboxed
from cosim.fmi.file.intervals import Interval, Intervals, NextTick
from cosim.fmi.file.values import NumberedTexts
from cosim.fmi.isolation.protocol import answered, request
from cosim.fmi.layout import StepLayout
from cosim.fmi.library import NEVER, Clocked, Clocks, NativeCall, Setup
from cosim.fmi.options import PATIENCE, FmuOptions
from cosim.native import enums, fmu_log, structs
from cosim.native.enums import Lost
from cosim.native.shared import library
from cosim.native.structs import MailboxStruct, MailEndStruct

#: Seconds between two looks whether the run was asked to stop.
_GLANCE = 0.2
#: Seconds a call may still take when it was.
_GRACE = 1.0
#: Whether each side wakes the other by a byte in its pipe: there are no futexes.
BYTES_WAKE = sys.platform != "linux"


class RemoteInstance:
    """An instance in another process: the members of :class:`cosim.fmi.library.Instance`.

    `scalars`: how many signals it has; `room`: bytes of its log. `stays`: when it is freed, its
    process waits for another one (:meth:`again`). Raises FmuError when the process ends or a call
    takes longer than `options.timeout` (s).
    """

    handle = broken = 0
    sandboxed = False  # its process may have one
    numbered: NumberedTexts  # none: texts of an isolated FMU are not connected
    next_event = NEVER  # known where the FMU is
    next_ticks: Mapping[int, NextTick] = {}

    def __init__(
        self, setup: Setup, options: FmuOptions, scalars: int, room: int, *, stays: bool = False
    ) -> None:
        if os.name != "posix":
            raise FmuError(f"{setup.name}: isolate needs Linux or macOS")
        self._name, self._stop = setup.name, c.c_int32()
        self._scalars, self._room, self._stays, self._waiting = scalars, room, stays, False
        offset = -(-(c.sizeof(fmu_log.Log) + room) // 64) * 64
        size = offset + c.sizeof(MailboxStruct) + 8 * max(1, scalars)
        from multiprocessing.connection import Connection  # of no use to others, and slow to load

        with tempfile.TemporaryFile() as file:
            file.truncate(size)
            self._memory = mmap.mmap(file.fileno(), size)  # holds a copy of the descriptor
            self._process = _spawn(file.fileno(), size, offset, int(BYTES_WAKE))
        assert self._process.stdin is not None and self._process.stdout is not None
        self._ask = Connection(os.dup(self._process.stdin.fileno()), readable=False)
        self._answers = Connection(os.dup(self._process.stdout.fileno()), writable=False)
        self._process.stdin.close()
        self._process.stdout.close()
        self.log = fmu_log.log(self._memory, room)
        box = c.addressof(MailboxStruct.from_buffer(self._memory, offset))
        self._end = MailEndStruct(
            box=box, signals=box + c.sizeof(MailboxStruct), stop=c.addressof(self._stop),
            patience=options.timeout, bytes=BYTES_WAKE,
            incoming=self._answers.fileno(), outgoing=self._ask.fileno(),
        )  # fmt: skip
        try:
            self._timeout = max(PATIENCE, options.timeout)  # until Python runs: no FMU's fault
            self._call("ready")
            if not is_sandboxed(setup.path):  # which is compiled first
                self._timeout = options.timeout
            limit = 0 if is_sandboxed(setup.path) else options.memory  # a sandbox keeps its own
            self._call("start", setup, room, limit)
            self._timeout = options.timeout
        except BaseException:
            self.end()
            raise

    @property
    def pid(self) -> int:
        """The number of its process."""
        return self._process.pid

    # ---- messages ----------------------------------------------------------------------------

    def _call(self, name: str, *arguments: Any) -> Any:
        if self._ask.closed:
            self._fail(f"no {name} after its end")
        engine, end = library(), c.byref(self._end)
        try:
            engine.engine_ask(end)
            self._ask.send_bytes(request(name, arguments))
            lost = self._await()
            if lost is not Lost.NOT:
                raise FmuError(self.lost(lost, name))
            return answered(name, self._answers.recv_bytes())
        except (EOFError, OSError):
            self._fail(f"its process ended in {name}: {self._status()}")

    def _await(self) -> Lost:
        """Wait for an answer, in short turns: between them, Python handles Ctrl-C."""
        patience, waited, stopped = self._timeout, 0.0, False
        while waited < patience:
            turn = min(_GLANCE, patience - waited)
            lost = Lost(library().engine_await(c.byref(self._end), turn))
            if lost not in (Lost.LATE, Lost.STOPPED):
                return lost
            waited += turn
            if not stopped and c.c_int32.from_address(self._end.stop).value:
                stopped, patience = True, min(patience, waited + _GRACE)
        return Lost.STOPPED if stopped else Lost.LATE

    def lost(self, status: int, what: str) -> str:
        """End the process, which did not answer to `what`; returns the sentence about it.

        `status`: why, as C has it (:class:`Lost`).
        """
        why = Lost(status)
        if why is Lost.ENDED:
            return self._sentence(f"its process ended in {what}: {self._status()}")
        self._kill()
        after = "was stopped" if why is Lost.STOPPED else f"took longer than {self._timeout:g} s"
        return self._sentence(f"{what} {after} and was ended")

    def _sentence(self, what: str) -> str:
        return f"{self._name}: {what} ({self.log.said()})"

    def _fail(self, what: str) -> NoReturn:
        raise FmuError(self._sentence(what))

    def _kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _status(self) -> str:
        code = self._process.wait(timeout=10)
        return signal.Signals(-code).name if code < 0 else f"exit code {code}"

    # ---- the members of an instance ----------------------------------------------------------

    def returned(self, status: int) -> None:
        """Do nothing: the process of the FMU takes note itself."""

    def refuse(self, suffix: str, status: int) -> None:
        """Never called: C makes no calls of an FMU in another process (:meth:`native`)."""

    def native(self, verb: str, kind: str = "") -> NativeCall | None:
        """There are no addresses in this process: None."""

    def trapped(self) -> str:
        """Tell what it did in the call that ended it, in WebAssembly; "": nothing."""
        did: str = self._call("trapped")
        return did

    def watch(self, stop: int) -> None:
        """Do nothing: its end is that of the process."""

    def left(self) -> None:
        """Do nothing: the process of the FMU takes note itself."""

    def setup(self, t0: float) -> None:
        """Set up the experiment."""
        self._call("setup", t0)

    def enter_initialization(self, t0: float) -> None:
        """Enter Initialization Mode."""
        self._call("enter_initialization", t0)

    def intervals(self, clocks: Mapping[int, bool]) -> dict[int, Interval]:
        """Interval and shift of periodic clocks."""
        found: dict[int, Interval] = self._call("intervals", clocks)
        return found

    def set_intervals(self, given: Intervals) -> None:
        """Set the interval of fixed and tunable clocks."""
        self._call("set_intervals", given)

    def exit_initialization(self, clocks: Clocks | None = None) -> dict[str, list[float]]:
        """Leave Initialization Mode; values of clocks that ticked then."""
        found: dict[str, list[float]] = self._call("exit_initialization", clocks)
        return found

    def has_ended(self) -> bool:
        """True if it ended the simulation in the events of its start."""
        ended: bool = self._call("has_ended")
        return ended

    def terminated(self) -> float | None:
        """After a step that was discarded: the time (s) it came to if it ends the simulation."""
        time: float | None = self._call("terminated")
        return time

    def clocked_texts(self) -> dict[str, list[str]]:
        """Texts of clocks as they were when these last ticked."""
        found: dict[str, list[str]] = self._call("clocked_texts")
        return found

    def set_clocked_texts(self, found: dict[str, list[str]]) -> None:
        """Go back to such texts of an earlier time."""
        self._call("set_clocked_texts", found)

    def take_texts(self, found: Clocked) -> None:
        """Get such a text, now that its clock ticks."""
        self._call("take_texts", found)

    def get(self, kind: str, references: Sequence[int], count: int) -> list[float]:
        """Values of variables of an FMI type."""
        found: list[float] = self._call("get", kind, references, count)
        return found

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        """Set variables of an FMI type."""
        self._call("set", kind, references, values)

    def get_texts(self, kind: str, references: Sequence[int], count: int) -> list[str]:
        """Values of String or Binary variables."""
        found: list[str] = self._call("get_texts", kind, references, count)
        return found

    def set_texts(self, kind: str, references: Sequence[int], values: Sequence[str]) -> None:
        """Set String or Binary variables."""
        self._call("set_texts", kind, references, values)

    def enter_configuration(self) -> None:
        """See :class:`cosim.fmi.library.Instance`."""
        self._call("enter_configuration")

    def exit_configuration(self) -> None:
        """See :class:`cosim.fmi.library.Instance`."""
        self._call("exit_configuration")

    def address(self, suffix: str) -> int:
        """There is none in this process."""
        raise FmuError(f"{self._name}: {suffix} is in another process")

    def functions(self) -> dict[int, str]:
        """There are none in this process."""
        return {}

    def loop_functions(self) -> tuple[int, int, int]:
        """There are none in this process."""
        raise FmuError(f"{self._name}: its functions are in another process")

    def directional(
        self, unknowns: Sequence[int], knowns: Sequence[int], seed: Sequence[float], count: int
    ) -> list[float]:
        """Derivatives of variables along a direction of others, in their units."""
        found: list[float] = self._call("directional", unknowns, knowns, seed, count)
        return found

    def state_functions(self) -> tuple[int, int]:
        """There are none in this process."""
        raise FmuError(f"{self._name}: its functions are in another process")

    def steps_function(self) -> int:
        """There is none."""
        return 0

    def values_address(self) -> int:
        """They are in another process."""
        return 0

    def places(self, reference: int) -> range:
        """There are none in this process. Raises FmuError."""
        raise FmuError(f"{self._name}: its values are in another process")

    def do_step(self, t: float, h: float) -> None:
        """One communication step, outside of an engine."""
        self._call("do_step", t, h)

    def get_state(self) -> int:
        """Save the state there; returns its handle there."""
        state: int = self._call("get_state")
        return state

    def reset(self) -> None:
        """Back to as it was instantiated."""
        self._call("reset")

    def set_state(self, state: int) -> None:
        """Go back to a state saved there."""
        self._call("set_state", state)

    def free_state(self, state: int) -> None:
        """Give a state saved there back."""
        self._call("free_state", state)

    def serialized(self) -> bytes:
        """The state there as bytes, with that of its clocks and of its solver."""
        found: bytes = self._call("serialized")
        return found

    def set_serialized(self, data: bytes) -> None:
        """Go to a state that was serialized in such a process."""
        self._call("set_serialized", data)

    def bind(self, here: StepLayout, there: StepLayout, stop: int) -> structs.UnitStruct:
        """The engine's unit for it. `here`, `there`: where its signals are in each process; there,
        its inputs come first, slopes last. `stop`: address of what tells the engine to stop.
        """
        places = here.slopes.places if here.slopes else ()
        self._slopes = (c.c_int64 * max(1, len(places)))(*places)
        self._end.slopes, self._end.n_slopes = c.addressof(self._slopes), len(places)
        self._end.stop = stop
        self._call("bind", there)
        unit = structs.UnitStruct(
            kind=enums.UnitKind.REMOTE, lag=here.lag, h=here.h, period=here.period,
            input=here.input, input_count=here.input_count, output=here.output,
            output_count=here.output_count, instance=c.addressof(self._end), steps=1,
        )  # fmt: skip
        return unit

    def late_clock_ticks(self) -> tuple[int, float]:
        """Number of late clock ticks in the other process, and their greatest delay (s)."""
        found: tuple[int, float] = self._call("late_clock_ticks")
        return found

    def free(self) -> None:
        """Free the FMU if it still answers, and end its process unless it stays.

        May be called twice.
        """
        if self._waiting or (self._stays and self._rest()):
            return
        self.end()

    def _rest(self) -> bool:
        """Free the FMU in a process that goes on; whether it can have another instance."""
        if self._ask.closed or self._process.poll() is not None:
            return False
        if MailboxStruct.from_address(self._end.box).stop:  # it was told to hurry, and still would
            return False
        self._end.stop = c.addressof(self._stop)  # that of the engine will be gone
        try:
            self._waiting = self._call("rest")
        except FmuError:
            return False
        return self._waiting

    def again(self, setup: Setup, scalars: int) -> bool:
        """Make another instance where the process has waited for that; if not, it has to end.

        Raises FmuError.
        """
        fits = self._waiting and scalars <= self._scalars and self._process.poll() is None
        self._waiting = False
        if fits:
            self.log.forget()
            self._call("start", setup, self._room, 0)
        return fits

    def end(self) -> None:
        """Free the FMU if it still answers, and end its process; may be called twice."""
        if self._ask.closed:
            return
        try:
            if self._process.poll() is None and not self._waiting:
                self._call("free")
        except FmuError:
            pass  # it is ended below in any case
        self._ask.close()
        try:
            self._process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            self._kill()
        self._answers.close()
        self.log = self.log.copy(self._room)
        del self._memory  # with its file


def isolated(
    last: RemoteInstance | None,
    setup: Setup,
    options: FmuOptions,
    scalars: int,
    room: int,
    *,
    stays: bool,
) -> RemoteInstance:
    """An instance in the process of the `last` one, which is freed, or in a new one."""
    if last is not None:
        if last.again(setup, scalars):
            return last
        last.end()
    return RemoteInstance(setup, options, scalars, room, stays=stays)


def _spawn(descriptor: int, size: int, offset: int, bytes_wake: int) -> subprocess.Popen[bytes]:
    numbers = [str(n) for n in (descriptor, size, offset, bytes_wake)]
    return subprocess.Popen(
        python_call("cosim.fmi.isolation.worker", *numbers),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        pass_fds=(descriptor,),
    )
