"""Call-backs in a thread of ours, which no process waits for at its end.

Zenoh's own threads for call-backs are joined by an interpreter that ends. After an error, with a
session that does not close, they would hold the process, and the node's token, for ever.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import TypeVar

import zenoh

_T = TypeVar("_T")


def aside(call: Callable[[_T], None]) -> zenoh.handlers.Callback[_T]:
    """A call-back that hands what comes to `call` in a thread; it ends with its subscriber.

    An exception is reported as that of any thread, and the next call is made all the same.
    """
    waiting: queue.SimpleQueue[_T | None] = queue.SimpleQueue()

    def work() -> None:
        while (item := waiting.get()) is not None:
            try:
                call(item)
            except Exception as error:
                said = (type(error), error, error.__traceback__, threading.current_thread())
                threading.excepthook(threading.ExceptHookArgs(said))

    threading.Thread(target=work, name="zenoh call-back", daemon=True).start()
    return zenoh.handlers.Callback(waiting.put, lambda: waiting.put(None), indirect=False)
