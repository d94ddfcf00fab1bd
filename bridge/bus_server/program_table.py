"""The memory that programs in bus time share with the process that has the bus.

The library ``bridge/_preload.so`` (``bridge/c/preload``) is loaded into the programs by
``LD_PRELOAD``; the process of the bus calls the functions ``coordinator_*`` of the same library.
"""

from __future__ import annotations

import ctypes as c
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, final

from cosim.base.errors import CosimError

_NEVER = 2**63 - 1
_MOST_PROGRAMS = 64


class ProgramThread(NamedTuple):
    """A thread of a program: the number of each, from 0 and 1, and those of the system."""

    program: int
    number: int
    pid: int
    tid: int


def preload_path() -> Path:
    """The path of the library for LD_PRELOAD. Raises CosimError where there is none."""
    path = Path(__file__).parent.with_name("_preload.so")
    if not path.is_file():
        raise CosimError(
            f"{path} is missing: programs in simulated time need Linux and an installation "
            "(pip install .), which builds it"
        )
    return path


@lru_cache(maxsize=1)
def _library() -> c.CDLL:
    found = c.CDLL(str(preload_path()))
    table, place, time = c.c_void_p, c.c_int32, c.c_int64
    for name, result, arguments in (
        ("make", table, (c.c_char_p, time, time)),
        ("free", None, (table,)),
        ("settle", c.c_int, (table, time)),
        ("next", place, (table,)),
        ("earliest", time, (table,)),
        ("now", time, (table,)),
        ("advance", None, (table, time)),
        ("grant", None, (table, place, time)),
        ("revoke", None, (table,)),
        ("ring", None, (table,)),
        ("threads", c.c_int32, (table, c.c_int32)),
        ("culprit", None, (table, c.POINTER(c.c_int32 * 4))),
    ):
        function = getattr(found, f"coordinator_{name}")
        function.restype, function.argtypes = result, arguments
    return found


@final
class ProgramTable:
    """The threads of programs, and bus time as they see it. Times are ns of the bus.

    `path`: a new file; `date_ns`, `monotonic_ns`: CLOCK_REALTIME and CLOCK_MONOTONIC at time 0.
    Raises CosimError where it cannot be made.
    """

    def __init__(self, path: Path, date_ns: int, monotonic_ns: int) -> None:
        self._library = _library()
        self._table = self._library.coordinator_make(str(path).encode(), date_ns, monotonic_ns)
        if not self._table:
            raise CosimError(f"{path}: found that no file can be made there, expected a folder")

    def __del__(self) -> None:
        """Give the memory back when no thread of the server needs it any more."""
        if getattr(self, "_table", None):
            self._library.coordinator_free(self._table)

    @property
    def now_ns(self) -> int:
        """The time that programs see, ns."""
        return int(self._library.coordinator_now(self._table))

    def settle(self, most_ns: int) -> bool:
        """Wait until all threads wait; False if they do not within `most_ns` of the wall clock."""
        return bool(self._library.coordinator_settle(self._table, most_ns))

    def next(self) -> int | None:
        """The first thread that can go on now; None: there is none."""
        found = int(self._library.coordinator_next(self._table))
        return None if found < 0 else found

    def earliest_ns(self) -> int | None:
        """The earliest time at which a thread continues, ns; None: no thread waits for a time."""
        found = int(self._library.coordinator_earliest(self._table))
        return None if found == _NEVER else found

    def advance(self, now_ns: int) -> None:
        """Set the time that programs see, ns."""
        self._library.coordinator_advance(self._table, now_ns)

    def grant(self, place: int, horizon_ns: int | None) -> None:
        """Let a thread go on. Before `horizon_ns` nothing happens but what it does itself."""
        until = _NEVER if horizon_ns is None else horizon_ns
        self._library.coordinator_grant(self._table, place, until)

    def revoke(self) -> None:
        """The thread that runs may no longer let time pass by itself."""
        self._library.coordinator_revoke(self._table)

    def ring(self) -> None:
        """Let `settle` look again at once."""
        self._library.coordinator_ring(self._table)

    def threads(self, program: int) -> int:
        """The number of threads that a program has had so far."""
        return int(self._library.coordinator_threads(self._table, program))

    def culprit(self) -> ProgramThread:
        """The thread that did not wait when `settle` looked last."""
        found = (c.c_int32 * 4)()
        self._library.coordinator_culprit(self._table, c.byref(found))
        return ProgramThread(*found)
