"""Processes that a test forks: none of them comes back into pytest.

A child that did would run the parent's tests a second time, on the parent's pipes.
"""

from __future__ import annotations

import ctypes
import os
import pty
import signal
import sys
import traceback
from collections.abc import Callable
from typing import NoReturn

#: Exit code of a child whose work raised something, or returned no exit code.
FAILED = 99
_PR_SET_PDEATHSIG = 1


def fork(work: Callable[[], int]) -> int:
    """Call `work` in a child, which ends with its exit code, and before its parent; its pid."""
    return _fork(lambda: (os.fork(), -1), work)[0]


def fork_on_terminal(work: Callable[[], int]) -> tuple[int, int]:
    """The same on a terminal of its own: the pid, and this side of the terminal."""
    return _fork(pty.fork, work)


def _fork(way: Callable[[], tuple[int, int]], work: Callable[[], int]) -> tuple[int, int]:
    sys.stdout.flush()
    sys.stderr.flush()
    parent = os.getpid()
    # A signal between fork and `_end` would leave the child where pytest is.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    process, terminal = way()
    if not process:
        _end(work, parent, blocked)
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return process, terminal


def _end(work: Callable[[], int], parent: int, blocked: set[signal.Signals]) -> NoReturn:
    code: object = FAILED
    try:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() == parent:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
            code = work()
    except SystemExit as end:
        code = 0 if end.code is None else end.code
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code & 0xFF if isinstance(code, int) else FAILED)
