"""Waiting for an entry of a queue, up to some time."""

from __future__ import annotations

import queue
from typing import TypeVar

_T = TypeVar("_T")


def take(waiting: queue.SimpleQueue[_T], seconds: float) -> _T:
    """The next entry of a queue that one thread takes from; waits for it up to `seconds` (s).

    Raises queue.Empty if none came. `SimpleQueue.get` with a timeout alone can wait for ever in
    CPython 3.11: the lock of an empty queue may be free, since an entry was put while no thread
    waited. Then it is taken at once, and if the time is over when `get` looks again, the rest of it
    is negative, which means no limit. The first look here takes the lock.
    """
    try:
        return waiting.get_nowait()
    except queue.Empty:
        return waiting.get(timeout=max(0.0, seconds))
