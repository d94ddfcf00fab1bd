"""A limit of wall time for a part of a test."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from cosim.base.convert import Number, number
from cosim.base.errors import RunError


class TimeLimitError(RunError):
    """A run of a test took longer than its limit."""


class _TimeUpError(Exception):
    """Raised in the thread that took too long, wherever its Python code is."""


@contextmanager
def time_limit(limit: Number) -> Iterator[None]:
    """Raise TimeLimitError if the block takes longer than `limit`, s or a text with a unit.

    The block ends at the next step of its Python code: also in a component that loops for ever,
    which the error then names, but not inside of one call of foreign C code.
    """
    seconds, thread, over = number(limit, "s", "limit"), threading.get_ident(), threading.Event()

    def end() -> None:
        over.set()
        _raise_in(thread, _TimeUpError)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        try:
            yield
        finally:
            timer.cancel()
            timer.join()
            _raise_in(thread, None)
    except (_TimeUpError, RunError) as error:
        if not over.is_set():
            raise
        why = "" if isinstance(error, _TimeUpError) else f": {error}"
        raise TimeLimitError(f"the run took longer than its limit of {seconds:g} s{why}") from error


def _raise_in(thread: int, error: type[Exception] | None) -> None:
    """Raise an exception in a thread; None: take back one that was not raised yet."""
    target = None if error is None else ctypes.py_object(error)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), target)
