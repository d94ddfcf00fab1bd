"""Supervision of a guest: no process remains after a run, even if the launcher is killed.

There are two processes. The *front* is the process that the caller started: it forwards signals and
returns the exit status. The *watcher* runs the guest, in a separate session, so that signals to the
caller's process group do not reach it. When the front ends, even by SIGKILL, the kernel sends
SIGTERM to the watcher (PR_SET_PDEATHSIG), which stops the guest in an orderly way. Both adopt
orphans (PR_SET_CHILD_SUBREAPER), so each can end all its descendants.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from bridge.vcan.errors import VcanError
from cosim.base.clock import stopwatch
from cosim.base.errors import CosimError
from cosim.base.interrupts import hear_of_children

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
#: What stops a run. SIGUSR1: the watcher's own, for output that nobody reads any more.
READER_GONE = signal.SIGUSR1
_STOPPING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, READER_GONE}
_WATCHED = {*_STOPPING, signal.SIGCHLD}
#: Exit statuses that are the launcher's own, as of timeout(1) and env(1).
TIMED_OUT, FAILED = 124, 125
GRACE = 5.0  # s, between the request to end, the order to end, and the end
_LONGEST = 3600.0  # s, of one wait


def supervised(work: Callable[[], int]) -> int:
    """The exit status of `work`, which runs in the watcher."""
    sys.stdout.flush()
    sys.stderr.flush()
    hear_of_children()
    signal.pthread_sigmask(signal.SIG_BLOCK, _WATCHED)
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    front = os.getpid()
    watcher = os.fork()
    if watcher == 0:
        os._exit(_watch(work, front))
    ended = None
    while ended is None:
        number = signal.sigwait(_WATCHED)
        if number != signal.SIGCHLD:
            os.kill(watcher, number)
            continue
        pid, status = os.waitpid(watcher, os.WNOHANG)
        ended = status if pid else None
    end_descendants()
    return as_status(os.waitstatus_to_exitcode(ended))


def _watch(work: Callable[[], int], front: int) -> int:
    os.setsid()
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != front:
        return FAILED
    try:
        return work()
    except CosimError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_code
    except BaseException:
        traceback.print_exc()
        return FAILED
    finally:
        end_descendants()
        sys.stderr.flush()


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def start_command(
    command: Sequence[str | bytes],
    *,
    cpu: int | None = None,
    files: tuple[int, ...] = (),
    **more: object,
) -> subprocess.Popen[bytes]:
    """The command, started with default signals and, if given, on one CPU.

    `files` are descriptors it inherits; `more` are arguments of Popen. Raises VcanError if the
    command cannot be started.
    """

    def prepare() -> None:
        signal.pthread_sigmask(signal.SIG_SETMASK, [])
        if cpu is not None:
            os.sched_setaffinity(0, {cpu})

    try:
        return subprocess.Popen(command, preexec_fn=prepare, pass_fds=files, **more)  # type: ignore[call-overload,no-any-return]
    except OSError as error:
        raise VcanError(f"cannot start {os.fsdecode(command[0])}: {error.strerror}") from error


def wait_for_process(
    process: subprocess.Popen[bytes], timeout: float, tell: Callable[[signal.Signals], None]
) -> signal.Signals | None:
    """Wait for the end of the process, and end it if necessary.

    `timeout` (s) or a signal to this process stops it: the process receives that signal (SIGTERM at
    a time-out), then SIGKILL after `GRACE` or at the next signal. Returns the cause (SIGALRM: the
    time-out), None: it ended by itself.
    """
    passed, deadline = stopwatch(), timeout
    cause: signal.Signals | None = None
    steps: list[Callable[[], None]] = [process.kill, lambda: tell(signal.SIGKILL)]
    while process.poll() is None:
        left = max(0.0, deadline - passed())
        got = signal.sigtimedwait(_WATCHED, min(left, _LONGEST))
        number = signal.Signals(got.si_signo) if got else signal.SIGALRM
        if number == signal.SIGCHLD or (got is None and passed() < deadline):
            continue
        if cause is None:
            cause = number
            tell(number if number in (signal.SIGINT, signal.SIGHUP) else signal.SIGTERM)
        elif steps:
            steps.pop()()
        deadline = passed() + GRACE
    return cause


def status_of(cause: signal.Signals | None, status: int | None) -> int | None:
    """The exit status of a run that ended with `status` (None: without), stopped by `cause`."""
    if cause == signal.SIGALRM:
        return TIMED_OUT
    if cause == READER_GONE:
        return 128 + signal.SIGPIPE
    return 128 + cause if status is None and cause else status


def as_status(code: int) -> int:
    """An exit code of Python's (negative: a signal) as a shell's exit status."""
    return 128 - code if code < 0 else code


def end_descendants() -> None:
    """Kills every process that descends from this one and waits for it."""
    for pid in descendants(os.getpid()):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    while True:
        try:
            os.waitpid(-1, 0)
        except ChildProcessError:
            return
        for pid in descendants(os.getpid()):  # orphans adopted meanwhile
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def descendants(root: int) -> list[int]:
    """Process ids of all that descend from process `root`, children before their own."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                parent = (entry / "stat").read_text(errors="replace").rpartition(")")[2].split()[1]
                children.setdefault(int(parent), []).append(int(entry.name))
    found = [root]
    for pid in found:
        found += children.get(pid, [])
    return found[1:]
