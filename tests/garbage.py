"""Garbage collection while tests run: what pytest has collected is not looked at again."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from mmap import PAGESIZE
from types import ModuleType

#: Python's own, which `freeze_tests` replaces.
freeze, unfreeze = gc.freeze, gc.unfreeze


def freeze_tests() -> None:
    """Set aside all objects there are, until the process ends.

    A node sets aside its objects and takes all back at its end. Here it does neither: the tests
    would not stay where they are, and those of the node would, with all that they hold.
    """
    gc.collect()
    freeze()
    gc.freeze = gc.unfreeze = lambda: None


#: How much more memory, MiB, and how many more open files since the last time are cleaned up.
MEMORY, FILES = 12, 16
#: How much more memory, MiB, after any test makes a search for garbage. Garbage that waits for the
#: end of its file leaves holes when it goes, between what stays, and the process remains large.
GARBAGE = 8
#: Packages whose functions may cache; one with fewer results than MANY may hold a loaded library.
OURS, MANY = ("bridge", "cosim", "fmus", "tests"), 6
#: Caches that stay: a library stays loaded anyway, and the calls of a start that are kept with a
#: description have the addresses of its functions, whose names are there.
KEPT = {("cosim.fmi.library", "_loaded")}


#: Settings of glibc: what is larger than 128 KiB is memory of its own, which goes when it is freed,
#: and few threads have a heap of their own. By default the limit grows to 32 MiB.
_MMAP_THRESHOLD, _ARENA_MAX = (-3, 128 << 10), (-8, 2)


def return_memory() -> None:
    """Let the C library give freed memory back to the system, where it is that of Linux."""
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "mallopt"):
        library.mallopt(*_MMAP_THRESHOLD)
        library.mallopt(*_ARENA_MAX)


class Tidier:
    """Keeps a process of tests small: what the tests of a file have cached or left goes with them.

    Errors keep the engines and files of their tests until garbage is looked for, and files of tests
    keep the runs that they made once.
    """

    def __init__(self) -> None:
        self._memory, self._files = _used()
        self._least = self._memory

    def after(self, module: ModuleType, following: ModuleType | None) -> bool:
        """After a test of `module`, before one of `following`: whether all caches were cleared."""
        if module is not following:
            forget(module)
        memory, files = _used()
        if memory >= self._least + GARBAGE:
            gc.collect()
            self._least = memory = _used()[0]
        self._least = min(self._least, memory)
        small = memory < self._memory + MEMORY and files < self._files + FILES
        if following is not None and (module is following or small):
            return False
        for name, loaded in list(sys.modules.items()):
            if name.partition(".")[0] in OURS:
                forget(loaded, least=MANY)
        gc.collect()
        if sys.platform == "linux":
            ctypes.CDLL(None).malloc_trim(0)
        self._memory, self._files = _used()
        self._least = self._memory
        return True


def forget(module: ModuleType, least: int = 1) -> None:
    """Clear what functions of a module have cached, where there are at least so many results."""
    for name, value in list(vars(module).items()):
        if getattr(value, "__module__", "") != module.__name__ or not hasattr(value, "cache_clear"):
            continue
        if (module.__name__, name) in KEPT:
            continue
        if value.cache_info().currsize >= least:
            value.cache_clear()


def _used() -> tuple[int, int]:
    """Memory of this process, MiB, and the number of its open files; 0 where it is not known."""
    if sys.platform != "linux":
        return 0, 0
    with open("/proc/self/statm", encoding="ascii") as file:
        pages = int(file.read().split()[1])
    return pages * PAGESIZE >> 20, len(os.listdir("/proc/self/fd"))
