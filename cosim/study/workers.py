"""Workers of a sweep other than processes (:func:`cosim.base.processes.processes`).

Threads run in parallel in the engine, which releases the GIL, but not in the Python code that reads
a scenario and computes metrics. Processes run in parallel everywhere, and a component that crashes
ends one of them and not the sweep. Processes are the default.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from cosim.base.clock import stopwatch
from cosim.base.errors import RunError, ScenarioError
from cosim.base.processes import DIED, Pool
from cosim.fmi.failures import sentence

#: Runs in a call on a cluster, whose scheduler takes a millisecond for each.
LEAST = 16
#: How long a scheduler may take to answer, s.
PATIENCE = 10.0
#: Time after which a scheduler is asked again for its workers, s.
ASKED = 1.0


@contextmanager
def threads(jobs: int) -> Iterator[Pool]:
    """`jobs` threads of this process."""
    with ThreadPoolExecutor(jobs, thread_name_prefix="sweep") as executor:
        yield Pool(executor, lambda: jobs)


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
        yield Pool(client.get_executor(pure=False), count, LEAST, _lost)
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


def _lost(error: BaseException) -> str:
    """The reason why a worker of a cluster gave no result. Raises RunError where the cluster is
    gone.
    """
    if type(error).__name__ == "KilledWorker":
        return DIED
    raise RunError(f"the workers of the cluster are gone: {sentence(error)}") from error
