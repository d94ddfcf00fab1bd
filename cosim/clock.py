"""The only reader of clocks. (Simulated, scaled and wall pacing come with real time.)"""

from __future__ import annotations

import time
from collections.abc import Callable


def stopwatch() -> Callable[[], float]:
    """A function that returns the wall seconds since this call."""
    start = time.perf_counter()
    return lambda: time.perf_counter() - start


def stamp() -> str:
    """Local date and time for names of folders: ``20260131-235959``."""
    return time.strftime("%Y%m%d-%H%M%S")
