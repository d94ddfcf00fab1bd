"""Worker processes: a pool whose processes cannot even start is told from a call that ends one."""

from __future__ import annotations

from concurrent.futures import Executor
from concurrent.futures.process import BrokenProcessPool

from cosim.base.errors import RunError


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
