"""Ctrl-C while C runs: a loop stops between two ticks instead of somewhere inside a call-back."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def deferred(stop: Callable[[], None]) -> Iterator[None]:
    """Turn the first SIGINT of the block into `stop()`, and KeyboardInterrupt at its end.

    Python raises KeyboardInterrupt wherever it next gets to run; in a function that C calls, that
    is before the function's first line, where nobody can catch it and it is lost. The second
    SIGINT raises at once, for a component that hangs. Only in the main thread and where Python's
    own handler is in place; elsewhere the block runs as it is.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    pressed = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        if pressed:
            signal.default_int_handler(number, frame)
        pressed = True
        stop()

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if pressed:
        raise KeyboardInterrupt


@contextmanager
def terminated() -> Iterator[None]:
    """SIGTERM is a Ctrl-C in the block, where this thread may say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
