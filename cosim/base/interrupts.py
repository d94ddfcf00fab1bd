"""Signals that end a command: a loop in C stops between two ticks, not inside a call-back.

SIGINT (Ctrl-C), SIGTERM and SIGHUP all mean the same: stop, keep what was recorded, and end with
exit code 128 + the number of the signal: 130, 143 and 129.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

#: The signals that end a command, by name; Windows has no SIGHUP.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in dir(signal)
)
#: The signal that came last: signals belong to the process, and so does this.
_received: list[int] = []


def exit_code() -> int:
    """Exit code of a command that a signal has ended: 130, 143 or 129; 130 if none has come."""
    return 128 + (_received[-1] if _received else int(signal.SIGINT))


def _interrupt(number: int, frame: FrameType | None) -> None:
    _received[:] = [number]
    raise KeyboardInterrupt


@contextmanager
def _signal_handler(handler: Callable[[int, FrameType | None], None], ours: bool) -> Iterator[None]:
    """Install `handler` for the ending signals in the block.

    Signals that other code handles or ignores are not changed. `ours`: only if Python's own handler
    or :func:`signals_as_interrupt` is installed, not if the default action would end the process.
    """
    free = {signal.default_int_handler, _interrupt} | (set() if ours else {signal.SIG_DFL})
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: h for n in ENDING if (h := signal.getsignal(n)) in free}
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextmanager
def stop_on_signal(stop: Callable[[], None]) -> Iterator[None]:
    """Turn the first ending signal in the block into `stop()`, and KeyboardInterrupt at its end.

    Python raises KeyboardInterrupt where it runs next; in a function called by C, this is before
    the function's first line, where it cannot be caught and is lost. The second signal raises
    immediately, for a component that hangs. Applies to SIGINT if Python's own handler is installed,
    and to SIGTERM and SIGHUP inside of :func:`signals_as_interrupt`; only in the main thread.
    """
    pressed = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed:
            _interrupt(number, frame)
        _received[:] = [number]
        pressed = True
        stop()

    with _signal_handler(note, ours=True):
        yield
    if pressed:
        raise KeyboardInterrupt


@contextmanager
def signals_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP like Ctrl-C in the block, if this is the main thread."""
    with _signal_handler(_interrupt, ours=False):
        yield
