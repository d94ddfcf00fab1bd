"""Commands to a running node, and the answers that are passed on.

The node itself is C code without the GIL (``bridge/c/wall_clock.c``); threads here run next to it.
"""

from __future__ import annotations

import ctypes as c
import json
import queue
import signal
import socket
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Any, final

from bridge.native import node as native
from bridge.native.journal import Journal
from bridge.native.safety import Command, LifeState
from cosim.base.clock import monotonic_ns, sleep

Say = Callable[[Mapping[str, Any]], None]
#: s until a command has to be taken; between two looks whether journals need room.
TAKEN, ROOM = 0.5, 0.5


class Control:
    """Commands for a running node; callable from any thread."""

    def __init__(self, struct: native.NodeStruct) -> None:
        self._struct = struct
        self._asked = False
        #: In lock-step with checkpoints: the next time to stop at, ns, and the number of the state
        #: to be saved before, or -1.
        self.steps: queue.SimpleQueue[tuple[int, int]] = queue.SimpleQueue()

    def start(self, start_ns: int) -> None:
        """Set t = 0 to this time of the monotonic clock, or return the reason for a refusal."""
        self._struct.asked_ns = start_ns
        self._give(Command.START)

    def begin(self, lead: float) -> None:
        """Start `lead` s from now, or at the t = 0 of an EPOCH received within the last second.

        Does nothing if a START is already pending.
        """
        if self._struct.start_ns == 0:
            now, lead_ns = monotonic_ns(), round(lead * 1e9)
            self.start(native.functions().node_origin(c.byref(self._struct), now, lead_ns))

    def arm(self) -> None:
        """Torque may follow START: needed where real drives are meant; a rehearsal arms itself."""
        self._give(Command.ARM)

    def reset(self) -> None:
        """Forget why it has stopped; torque needs ARM and START again."""
        self._asked = False
        self._give(Command.RESET)

    def rearm(self) -> None:
        """ARM and START of a node that runs, after RESET."""
        self.arm()
        self._give(Command.START)

    def estop(self) -> None:
        """Emergency stop of all nodes on this node's buses."""
        self._struct.alarm = native.RAISED

    def go_on(self, until_ns: int, save: int) -> None:
        """Run to this time, in lock-step with checkpoints, after saving the state."""
        self.steps.put((until_ns, save))

    def jump(self, by_ns: int) -> None:
        """Let this node take it to be so much later from now on: a clock that was set."""
        self._struct.start_ns -= by_ns

    def stop(self) -> None:
        """Ramp down and stop; stop immediately if called again or before START was executed."""
        struct = self._struct
        obeyed = struct.begun or struct.life.state == LifeState.ACTIVE
        if self._asked or not (struct.start_ns and obeyed):
            struct.quit = 1
        self._asked = True
        self._give(Command.STOP)

    def quit(self) -> None:
        """Stop immediately, without a ramp: the last torque sent is zero."""
        self._struct.quit = 1

    def _give(self, command: Command) -> None:
        """Add a command to those of the next slot, and wait until the node has taken them."""
        native.functions().node_tell(c.byref(self._struct), command)
        for _ in range(round(TAKEN / 0.001)):
            if not self._struct.told or self._struct.quit:
                return
            sleep(0.001)


@final
class Helpers:
    """Threads next to a node that runs in C: an error in one of them stops the node.

    Otherwise it would wait for ever, with its buses open, for what such a thread does no more.
    """

    def __init__(self, control: Control) -> None:
        self._control = control
        self._failed: list[Exception] = []

    def start(self, name: str, work: Callable[[], None]) -> threading.Thread:
        """Start a thread that does `work`."""

        def guarded() -> None:
            try:
                work()
            except Exception as error:
                self._failed.append(error)
                self._control.stop()

        thread = threading.Thread(target=guarded, name=name, daemon=True)
        thread.start()
        return thread

    def check(self) -> None:
        """Raise the first error of a thread."""
        if self._failed:
            raise self._failed[0]


@contextmanager
def signals(control: Control) -> Iterator[None]:
    """Stop the node at SIGINT, SIGTERM and SIGHUP, from a thread: the main thread is in C.

    Python's C handler notifies the thread, in whichever thread of the process the signal arrives:
    libraries have threads that block no signal. Outside the main thread it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    wanted = [n for n in signal.Signals if n.name in ("SIGINT", "SIGTERM", "SIGHUP")]
    wanted = [n for n in wanted if n.name != "SIGHUP" or signal.getsignal(n) != signal.SIG_IGN]
    told, tells = socket.socketpair()
    tells.setblocking(False)

    def wait() -> None:
        while number := told.recv(1):
            if number[0] in wanted:
                control.stop()

    thread = threading.Thread(target=wait, name="signals", daemon=True)
    thread.start()
    before = {n: signal.signal(n, lambda *_: None) for n in wanted}
    descriptor = signal.set_wakeup_fd(tells.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        signal.set_wakeup_fd(descriptor)
        for number, handler in before.items():
            signal.signal(number, handler)
        tells.close()
        thread.join()
        told.close()


@contextmanager
def room_ahead(journals: Sequence[Journal], helping: Helpers) -> Iterator[None]:
    """Take disk and memory for rows before they are written, so that no slot waits for it.

    On a full disk the journals count the rows that do not fit.
    """
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(ROOM):
            for journal in journals:
                with suppress(OSError):
                    journal.make_room()

    thread = helping.start("room", look)
    try:
        yield
    finally:
        ended.set()
        thread.join()


def listen_to(stream: Iterable[str]) -> Callable[[Control], None]:
    """Commands from lines of JSON; when they end, whoever started this node is gone: it stops."""

    def listen(control: Control) -> None:
        for line in stream:
            message = json.loads(line)
            match message["command"]:
                case "start":
                    control.start(message["start_ns"])
                case "stop":
                    control.stop()
                case "quit":
                    control.quit()
                case "arm":
                    control.arm()
                case "reset":
                    control.reset()
                case "again":
                    control.rearm()
                case "jump":
                    control.jump(message["by_ns"])
                case "estop":
                    control.estop()
                case "go":
                    control.go_on(message["until_ns"], message["save"])
        control.stop()

    return listen
