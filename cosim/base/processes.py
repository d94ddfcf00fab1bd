"""Calls spread over processes, threads or a cluster: an Executor each, and one loop over it.

A component that crashes ends its process, and with it the whole pool: the call that did this is
found, and takes no other one with it.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait as wait_for
from typing import TypeVar

from cosim.base.clock import sleep
from cosim.base.errors import RunError
from cosim.base.interrupts import ENDING

T = TypeVar("T")
R = TypeVar("R")
#: Instead of a result: why there is none.
DIED = "the worker process died (a component crashed, or memory ran out)"
#: A task that stands for none: the next one follows from the results of others.
NOTHING_YET: tuple[()] = ()
#: Calls handed out for each that can run: nobody waits for the next one.
AHEAD = 2
#: How long a call may take to end when the parent is gone, s.
GRACE = 10.0


def _raised(error: Exception) -> str:
    raise error


@dataclass(frozen=True, slots=True)
class Pool:
    """An executor and the number of parallel calls, which may grow on a cluster.

    `least`: runs that make a call worth it. `lost`: why a call that raises has no result; what it
    raised is raised by default.
    """

    executor: Executor
    count: Callable[[], int]
    least: int = 1
    lost: Callable[[Exception], str] = _raised

    @property
    def slots(self) -> int:
        """The number of calls that can run at a time, as far as is known now."""
        return max(1, self.count())


Opened = Callable[[], AbstractContextManager[Pool]]

#: Numbers of parameters of mallopt (<malloc.h>).
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3


@contextmanager
def processes(jobs: int) -> Iterator[Pool]:
    """`jobs` processes, which always end with this one and ignore Ctrl-C.

    Leaving while calls are active (a second Ctrl-C) ends the processes immediately.
    """
    before = set(multiprocessing.active_children())
    executor = spawned(jobs)
    try:
        yield Pool(executor, lambda: jobs)
    except BaseException:
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def spawned(jobs: int) -> ProcessPoolExecutor:
    """An executor of `jobs` processes, which always end with this one and ignore Ctrl-C."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin)


def _begin() -> None:
    """Begin a worker process: leave Ctrl-C to the parent, and watch over its life."""
    leave_signals_to_parent({*ENDING} - {signal.SIGTERM})
    _keep_memory()


def _keep_memory() -> None:
    """Keep freed memory for the next arrays, where the C library is GNU's.

    By default arrays of more than 128 KiB come from the system and go back to it one by one, and
    the page faults of a run's arrays took a sixth of its processor time.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, 32 << 20)
        mallopt(_TRIM_THRESHOLD, 256 << 20)


def leave_signals_to_parent(ignored: Iterable[signal.Signals] = ENDING) -> None:
    """Ignore these signals in a worker process, which always ends with its parent."""
    for number in ignored:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_follow, name="parent", daemon=True).start()


def _follow() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)  # a call that cleans up behind itself does so
        sleep(GRACE)
        os._exit(1)


def require_start(executor: Executor) -> None:
    """Raise RunError if the processes of a new pool end before they do anything.

    A script without ``if __name__ == "__main__":`` has this effect, because each process imports
    the script and would start the processes again.
    """
    try:
        executor.submit(int).result()
    except BrokenProcessPool:
        raise RunError(
            "worker processes end before they start; in a script, expected the call below "
            '`if __name__ == "__main__":`, or one job'
        ) from None


# ---- the loop -----------------------------------------------------------------------------------


def spread(
    opened: Opened,
    function: Callable[[T], R],
    tasks: Iterable[T],
    stopped: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[T, R | str]]:
    """(task, result) in the order of completion; a text instead of the result if the worker died.

    If a process dies, all active calls are repeated one by one, each in a separate pool, which
    identifies the call that kills its process and saves the others. Once `stopped` returns true, no
    further calls are started, and active calls are completed. Raises what a call raises, except on
    a cluster, and RunError if the workers are lost or do not start.
    """
    rest = iter(tasks)
    while True:
        suspects: list[T] = []
        with opened() as pool:
            yield from _until_broken(pool, function, rest, stopped, suspects)
        if not suspects:
            return
        for task in suspects:
            if stopped():
                return
            with opened() as pool:
                require_start(pool.executor)
                broken: list[T] = []
                yield from _until_broken(pool, function, iter([task]), stopped, broken)
            if broken:
                yield task, DIED


def _until_broken(
    pool: Pool,
    function: Callable[[T], R],
    tasks: Iterator[T],
    stopped: Callable[[], bool],
    suspects: list[T],
) -> Iterator[tuple[T, R | str]]:
    """The results of :func:`spread` until a process dies: `suspects` are the tasks then out."""
    waiting: dict[Future[R], T] = {}
    while True:
        while len(waiting) < AHEAD * pool.slots and not suspects and not stopped():
            try:
                task = next(tasks)
            except StopIteration:
                break
            if task == NOTHING_YET:
                break
            try:
                waiting[pool.executor.submit(function, task)] = task
            except BrokenProcessPool:
                suspects.append(task)
        if not waiting:
            return
        if stopped():
            for future in [f for f in waiting if f.cancel()]:
                del waiting[future]
        for future in wait(waiting, return_when=FIRST_COMPLETED).done if waiting else ():
            task = waiting.pop(future)
            try:
                yield task, future.result()
            except BrokenProcessPool:
                suspects.append(task)
            except Exception as error:
                yield task, pool.lost(error)
