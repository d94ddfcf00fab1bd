"""Waiting for an entry of a queue ends, however short the time is."""

from __future__ import annotations

import queue
from threading import Thread

import pytest

from cosim.base.queues import take


def test_waiting_for_less_than_a_look_takes_ends() -> None:
    """With `SimpleQueue.get` alone, CPython 3.11 waits for ever once in some ten thousand times."""
    ended = []

    def wait() -> None:
        waiting: queue.SimpleQueue[int] = queue.SimpleQueue()
        for k in range(60_000):
            waiting.put(k)
            waiting.get_nowait()  # the lock of the queue is free
            try:
                take(waiting, 1e-6)
            except queue.Empty:
                continue
        ended.append(True)

    thread = Thread(target=wait, daemon=True)
    thread.start()
    thread.join(60)
    assert ended


def test_an_entry_that_comes_while_waiting_is_taken() -> None:
    waiting: queue.SimpleQueue[str] = queue.SimpleQueue()
    thread = Thread(target=lambda: waiting.put("came"))
    thread.start()
    assert take(waiting, 30.0) == "came"
    thread.join()
    waiting.put("next")
    assert take(waiting, -1.0) == "next"
    with pytest.raises(queue.Empty):
        take(waiting, -1.0)
