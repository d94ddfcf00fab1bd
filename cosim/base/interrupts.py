"""Signals that end a command: a flag, on which every loop and phase acts at a place of its own.

SIGINT (Ctrl-C), SIGTERM and SIGHUP all mean the same: stop, keep what was recorded, and end with
exit code 128 + the number of the signal: 130, 143 and 129.

The handler raises nothing: an exception in the middle of whatever code runs is lost in a destructor
or a call-back, or caught by a library. It sets the flag and stops the loops in C that run
(:func:`stop_on_signal`); Python raises KeyboardInterrupt where it asks (:func:`act_on_signal`).
Code that never asks, such as a library or a system call that waits, is reminded: KeyboardInterrupt
is raised there after :data:`PATIENCE`, again and again until something acts on it.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # what `signal` wraps, at a tenth of the cost
import _thread
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from types import FrameType
from typing import final

#: The signals that end a command, by name; Windows has no SIGHUP.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in dir(signal)
)
#: Wakes the main thread to be reminded; nothing happens where nobody handles it.
_WAKE = signal.Signals["SIGBREAK" if sys.platform == "win32" else "SIGURG"]
#: How long code may run on that does not ask for signals, s; then it is interrupted. So long, a
#: signal is not a second one either: a service manager sends it to every process of a command, and
#: the command's supervisor passes it on.
PATIENCE = 0.5
#: Until code is reminded again, s.
AGAIN = 0.25
_PR_SET_PDEATHSIG = 1


class _Stage(Enum):
    NONE = 0
    COME = 1
    RAISED = 2
    #: What was to be done about it is done, or is being done.
    ACKNOWLEDGED = 3


@final
class _Received:
    """The ending signal that came first: signals belong to the process, and so does this."""

    def __init__(self) -> None:
        self.number, self.stage, self.urgent = 0, _Stage.NONE, False
        self.stops: list[Callable[[], None]] = []
        self.patient, self.over = True, threading.Event()

    def come(self, number: int) -> None:
        """Take note of the first signal, and stop the loops that run."""
        self.number, self.stage = number, _Stage.COME
        for stop in self.stops:
            stop()
        threading.Thread(target=self._remind, daemon=True).start()

    def _remind(self) -> None:
        """Interrupt the main thread, also where it waits in a system call."""
        wait = PATIENCE
        while not self.over.wait(wait):
            wait, self.patient = AGAIN, False
            if sys.platform == "win32":
                _thread.interrupt_main(_WAKE)
            else:
                signal.pthread_kill(threading.main_thread().ident or 0, _WAKE)

    def interrupts(self) -> bool:
        """True if a reminder interrupts the code that runs now."""
        if self.stage not in (_Stage.COME, _Stage.RAISED) or (self.stops and not self.urgent):
            return False
        handled = sys.exc_info()[1]
        while handled is not None:  # what runs now acts on it
            if isinstance(handled, KeyboardInterrupt | SystemExit):
                return False
            handled = handled.__context__
        return True

    def stop(self) -> None:
        """Raise KeyboardInterrupt here."""
        self.stage = _Stage.RAISED
        raise KeyboardInterrupt


_received = [_Received()]


def hear_of_children() -> None:
    """Let the ends of child processes be known here, also where who started us ignores SIGCHLD.

    The kernel would forget them then, and who waits for one would wait for ever, or take it for a
    success.
    """
    if sys.platform != "win32" and signal.getsignal(signal.SIGCHLD) == signal.SIG_IGN:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def exit_code() -> int:
    """Exit code of a command that a signal has ended: 130, 143 or 129; 130 if none has come.

    Who asks for it acts on the signal, as :func:`acknowledge`.
    """
    acknowledge()
    return 128 + (_received[0].number or int(signal.SIGINT))


def has_come() -> bool:
    """True if an ending signal has come since :func:`signals_as_interrupt`."""
    return _received[0].stage is not _Stage.NONE


def acknowledge() -> None:
    """Go on after a signal, to complete what it has interrupted; another one interrupts that."""
    if has_come():
        _received[0].stage = _Stage.ACKNOWLEDGED


def act_on_signal() -> None:
    """Raise KeyboardInterrupt if an ending signal has come and nothing has acted on it yet.

    Not inside of :func:`stop_on_signal`, and only in the main thread.
    """
    now = _received[0]
    if now.stage is not _Stage.COME or now.stops:
        return
    if threading.current_thread() is threading.main_thread():
        now.stop()


def _note(number: int, frame: FrameType | None) -> None:
    """The handler of all ending signals, and of reminders of them."""
    now = _received[0]
    if number == _WAKE:
        if now.interrupts():
            now.stop()
    elif now.stage is _Stage.NONE:
        now.come(number)
    elif number == signal.SIGINT or not now.patient:
        now.urgent = True
        now.stop()


@contextmanager
def _noted(*free: object) -> Iterator[bool]:
    """Handle the ending signals in the block, those for which a handler of `free` is installed.

    Gives false where none is, or outside the main thread: what other code handles or ignores stays
    as it is.
    """
    found = {}
    if threading.current_thread() is threading.main_thread():
        found = {n: h for n in ENDING if (h := signal.getsignal(n)) in (*free, _note)}
    if found and (wake := signal.getsignal(_WAKE)) in (signal.SIG_DFL, _note):
        found[_WAKE] = wake
    before = {number: earlier for number, earlier in found.items() if earlier is not _note}
    outermost = len(before) == len(found)
    if found and outermost:
        _received[0] = _Received()
    try:
        for number in before:
            signal.signal(number, _note)
        yield bool(found)
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
        if found and outermost:
            _received[0].over.set()


@contextmanager
def stop_on_signal(stop: Callable[[], None]) -> Iterator[None]:
    """Turn the first ending signal in the block into `stop()`, and KeyboardInterrupt at its end.

    Nothing is interrupted in the block before a second signal, which raises KeyboardInterrupt
    immediately, for a component that hangs. Of blocks in each other the outermost raises. Applies
    to SIGINT if Python's own handler is installed, and to SIGTERM and SIGHUP inside of
    :func:`signals_as_interrupt`; only in the main thread.
    """
    with _noted(signal.default_int_handler) as noted:
        if not noted:
            yield
            return
        act_on_signal()
        stops = _received[0].stops
        stops.append(stop)
        try:
            yield
        finally:
            stops.pop()
        act_on_signal()


def stops_on_signal(stop: Callable[[], None]) -> bool:
    """True within :func:`stop_on_signal` of `stop`, if nothing else has taken Ctrl-C meanwhile.

    Another such block would add nothing, and costs ten times as much.
    """
    if stop not in _received[0].stops or _signal.getsignal(signal.SIGINT) is not _note:
        return False
    return threading.current_thread() is threading.main_thread()


@contextmanager
def until_signal() -> Iterator[None]:
    """Leave the block at an ending signal, and go on behind it."""
    try:
        yield
    except KeyboardInterrupt:
        acknowledge()


@contextmanager
def signals_as_interrupt() -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP end the block with KeyboardInterrupt, in the main thread.

    Also where the code in the block has lost it, or has come to its end without noticing.
    """
    with _noted(signal.SIG_DFL, signal.default_int_handler) as noted:
        try:
            yield
        except SystemExit:
            if not noted or _received[0].stage in (_Stage.NONE, _Stage.ACKNOWLEDGED):
                raise
        if noted and _received[0].stage in (_Stage.COME, _Stage.RAISED):
            _received[0].stop()


def die_with(parent: int) -> None:
    """Let this process be killed when its parent, of this number, ends, as far as Linux does it."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
