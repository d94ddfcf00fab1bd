"""Points spread over threads, processes or a cluster: an Executor each, and one loop over it.

Threads run in parallel in the engine, which releases the GIL, but not in the Python code that reads
a scenario and computes metrics. Processes run in parallel everywhere, and a component that crashes
ends one of them and not the sweep. Processes are the default.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait as wait_for
from typing import Any, Literal, TypeVar

from cosim.base.clock import sleep, stopwatch
from cosim.base.errors import RunError, ScenarioError
from cosim.base.processes import require_start
from cosim.fmi.failures import sentence

Workers = Literal["processes", "threads", "cluster"]
T = TypeVar("T")
R = TypeVar("R")
#: A task that stands for none: the next one follows from the results of others.
NOTHING_YET: tuple[()] = ()
#: Calls handed out for each that can run: nobody waits for the next one.
AHEAD = 2
#: Runs in a call on a cluster, whose scheduler takes a millisecond for each.
LEAST = 10
#: How long a scheduler may take to answer, s.
PATIENCE = 10.0
#: Time after which a scheduler is asked again for its workers, s.
ASKED = 1.0
#: How long a call may take to end when the parent is gone, s.
GRACE = 10.0


@dataclass(frozen=True, slots=True)
class Pool:
    """An executor and the number of parallel calls, which may grow on a cluster.

    `least`: runs that make a call worth it.
    """

    executor: Executor
    count: Callable[[], int]
    least: int = 1

    @property
    def slots(self) -> int:
        """How many calls can run at a time, as far as is known now."""
        return max(1, self.count())


Opened = Callable[[], AbstractContextManager[Pool]]


@contextmanager
def threads(jobs: int) -> Iterator[Pool]:
    """`jobs` threads of this process."""
    with ThreadPoolExecutor(jobs, thread_name_prefix="sweep") as executor:
        yield Pool(executor, lambda: jobs)


@contextmanager
def processes(jobs: int) -> Iterator[Pool]:
    """`jobs` processes, which always end with this one and ignore Ctrl-C.

    Leaving while calls are active (a second Ctrl-C) ends the processes immediately.
    """
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin)
    try:
        yield Pool(executor, lambda: jobs)
    except BaseException:
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def _begin() -> None:
    """What a worker process does first: leave Ctrl-C to the parent, and watch over its life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow, name="parent", daemon=True).start()


def _follow() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os.kill(os.getpid(), signal.SIGTERM)  # a call that cleans up behind itself does so
        sleep(GRACE)
        os._exit(1)


@contextmanager
def cluster(address: str) -> Iterator[Pool]:
    """The workers of a Dask scheduler, ``tcp://host:8786``. Raises ScenarioError, RunError."""
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError:
        raise ScenarioError("--scheduler needs Dask: pip install 'cosim-bridge[cluster]'") from None
    try:
        client = dask.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise RunError(f"no scheduler answers at {address}: {error}") from None
    try:
        count = _counted(client)
        if not count():
            raise RunError(f"the scheduler at {address} has no workers")
        yield Pool(client.get_executor(pure=False), count, LEAST)
    finally:
        client.close()


def _counted(client: Any) -> Callable[[], int]:
    """The threads of all workers, asked for now and then: jobs of a queue start when they may."""
    watch, known = stopwatch(), int(sum(client.nthreads().values()))

    def count() -> int:
        nonlocal watch, known
        if watch() > ASKED:
            watch, known = stopwatch(), int(sum(client.nthreads().values()))
        return known

    return count


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
    further calls are started, and active calls are completed. Raises RunError if the workers are
    lost.
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
                yield task, "the worker process died (a component crashed, or memory ran out)"


def _until_broken(
    pool: Pool,
    function: Callable[[T], R],
    tasks: Iterator[T],
    stopped: Callable[[], bool],
    suspects: list[T],
) -> Iterator[tuple[T, R | str]]:
    """As :func:`spread`, until a process dies: `suspects` are then the tasks that were out."""
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
                yield task, _lost(error)


def _lost(error: BaseException) -> str:
    """Why a worker of a cluster gave no result. Raises RunError where the cluster is gone."""
    if type(error).__name__ == "KilledWorker":
        return "the worker process died (a component crashed, or memory ran out)"
    raise RunError(f"the workers of the cluster are gone: {sentence(error)}") from error
