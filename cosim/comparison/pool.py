"""Calls spread over processes. A process that dies takes one call with it, not the others.

A component that crashes ends its process, and with it the whole pool. Calls start in the given
order, so the faulty call is one of the first unfinished ones. These are repeated one by one, each
in a separate pool, and then the other calls continue.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from cosim.base.processes import require_start

T = TypeVar("T")
R = TypeVar("R")


def spread(
    function: Callable[[T], R], tasks: Sequence[T], jobs: int
) -> Iterator[tuple[T, R | None]]:
    """(task, result) as they are done; the result is None where the process died.

    One job is done in this process, where nothing holds off a crash. What `function` raises is
    raised here; so is Ctrl-C, after the calls that run have ended. Raises RunError if no process
    starts.
    """
    if jobs < 2:
        for task in tasks:
            yield task, function(task)
        return
    waiting = list(range(len(tasks)))
    while waiting:
        left = set(waiting)
        for index, result in _batch(function, tasks, waiting, jobs):
            left.discard(index)
            yield tasks[index], result
        suspects, waiting = sorted(left)[:jobs], sorted(left)[jobs:]
        if suspects:
            with spawned(1) as alone:
                require_start(alone)
        for index in suspects:
            found = [result for _, result in _batch(function, tasks, [index], 1)]
            yield tasks[index], found[0] if found else None


def _batch(
    function: Callable[[T], R], tasks: Sequence[T], indices: Sequence[int], jobs: int
) -> Iterator[tuple[int, R]]:
    """Results until all are there, or the pool breaks."""
    pool = spawned(min(jobs, len(indices)))
    try:
        futures = {pool.submit(function, tasks[index]): index for index in indices}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        return
    finally:
        pool.shutdown(cancel_futures=True)


def spawned(jobs: int) -> ProcessPoolExecutor:
    """A pool of `jobs` processes that Ctrl-C leaves to the one that waits for them."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, context, initializer=_ignore_interrupts)


def _ignore_interrupts() -> None:
    """Ctrl-C is for the process that waits; it stops the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
