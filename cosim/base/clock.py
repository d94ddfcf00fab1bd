"""The only reader of clocks in Python; in C it is ``bridge/c/pace.c``.

All other code receives time as an argument. There are two clocks. The *monotonic* clock is never
set and is used for pacing and measuring. The *real-time* clock is the date; it can be set during a
run and is used only for names and to relate times to the outside world.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from cosim.base.interrupts import act_on_signal

#: Readings of two clocks of which the closest one counts.
READINGS = 5
#: Two readings of a clock at most this far apart are of one moment, ns.
CLOSE_NS = 2_000
#: A sleeper looks for signals so often, s.
NAP = 0.05


def stopwatch() -> Callable[[], float]:
    """A function that returns the wall seconds since this call."""
    start = time.perf_counter()
    return lambda: time.perf_counter() - start


def stamp() -> str:
    """Local date and time for names of folders: ``20260131-235959``."""
    return time.strftime("%Y%m%d-%H%M%S")


if sys.platform == "win32":  # before Python 3.13 time.monotonic() moves every 16 ms there

    def monotonic_ns() -> int:
        """Nanoseconds of the clock that deadlines are on: the performance counter."""
        return time.perf_counter_ns()

else:

    def monotonic_ns() -> int:
        """Nanoseconds of the clock that deadlines are on, since some moment: CLOCK_MONOTONIC.

        The clock of ``pace_now`` (``bridge/c/pace.h``), one for all processes of a machine: not
        set by anybody, slewed by time synchronisation.
        """
        return time.monotonic_ns()


def realtime_ns() -> int:
    """Nanoseconds since 1970-01-01 UTC: CLOCK_REALTIME. It may jump; never pace by it."""
    return time.time_ns()


def now_and_date() -> tuple[int, int]:
    """The times of :func:`monotonic_ns` and :func:`realtime_ns` at one moment, ns.

    Of some readings the one in which least time went by between the two clocks: a process that is
    interrupted between them for 30 ms would be wrong by as much.
    """
    readings = []
    for _ in range(READINGS):
        before, date, after = monotonic_ns(), realtime_ns(), monotonic_ns()
        readings.append((after - before, (before + after) // 2, date))
        if after - before < CLOSE_NS:
            break
    _, now, date = min(readings)
    return now, date


def realtime_offset_ns() -> int:
    """The offset from a time of :func:`monotonic_ns` to its date, ns (:func:`realtime_ns`)."""
    now, date = now_and_date()
    return date - now


def wall_time() -> float:
    """Time since 1970-01-01 UTC, in seconds; for stamps in logs and file names."""
    return time.time()


def sleep(seconds: float) -> None:
    """Sleep for at least `seconds` (s); return immediately if they are not positive.

    Raises KeyboardInterrupt if a signal ends the command (:mod:`cosim.base.interrupts`). For
    waiting outside of ticks (for a process to start, a peer to answer). Ticks wait for absolute
    deadlines in C.
    """
    end = time.monotonic() + seconds
    while seconds > 0:
        time.sleep(min(seconds, NAP))
        act_on_signal()
        seconds = end - time.monotonic()
