"""Execution of a command in a child process, supervised by the process that was started.

An FMU is foreign code in the process that runs it: it may crash, or call `exit(0)`. The command
therefore runs in a child process, which sends its exit code over a pipe as its last action. A child
that ends without this message did not finish, whatever its exit status is. The child is forked
before large imports, which takes about a millisecond.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

from cosim.base.errors import CosimError, shortage
from cosim.base.interrupts import (
    ENDING,
    die_with,
    exit_code,
    hear_of_children,
    signals_as_interrupt,
)
from cosim.base.streams import complete_output

#: The end of the pipe in a child that is supervised.
_told: list[int] = []


def announce_run_folder(folder: Path) -> None:
    """Tell the supervisor, if there is one, which run folder this command writes."""
    for pipe in _told:
        os.write(pipe, f"folder {folder.absolute()}\n".encode())


@contextmanager
def allow_terminal_input() -> Iterator[None]:
    """Let this process read the terminal in the block, for a question to the user.

    The child is in a separate process group, so for the terminal it is in the background, where
    reading stops a process. Raises ScenarioError if its supervisor is in the background, too.
    """
    if not _told or not sys.stdin.isatty():
        yield
        return
    from cosim.base.errors import ScenarioError

    terminal, before = sys.stdin.fileno(), os.getpgid(os.getppid())
    if os.tcgetpgrp(terminal) != before:
        raise ScenarioError("the command asks for confirmation, but it runs in the background")
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTTOU, signal.SIGTSTP})
    os.tcsetpgrp(terminal, os.getpgrp())
    try:
        yield
    finally:
        os.tcsetpgrp(terminal, before)
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)


def supervised(command: Callable[[], None]) -> int:
    """Call `command` in a child process; its exit code, 1 for a child that did not finish.

    SIGINT, SIGTERM and SIGHUP are passed on once, SIGTSTP stops both. When this process is killed
    the child is too (Linux). On Windows the command runs in this process.
    """
    if sys.platform == "win32":
        command()
        return 0
    hear_of_children()
    reading, writing = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    signals = {*ENDING, signal.SIGTSTP, signal.SIGCONT, signal.SIGCHLD}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(reading)
        os.setpgid(0, 0)  # Ctrl-C reaches it through its supervisor, once
        die_with(parent)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        _work(command, writing)
    os.close(writing)
    status = _wait(child, signals)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with open(reading, encoding="utf-8") as pipe:
        said = dict(line.rstrip("\n").split(" ", 1) for line in pipe)
    return int(said["code"]) if "code" in said else _finish_folder(status, said.get("folder", ""))


def end(code: int) -> NoReturn:
    """End this process with an exit code, without taking the interpreter apart as :func:`_end`.

    On Windows, where this process has run the command, it ends as usual.
    """
    if sys.platform == "win32":
        sys.exit(code)
    code = complete_output(code)
    sys.stderr.flush()
    os._exit(code)


def _work(command: Callable[[], None], writing: int) -> NoReturn:
    """The child: run the command, and tell its exit code before the interpreter shuts down."""
    codes: list[int] = []
    atexit.register(_end, codes)
    _told.append(writing)
    codes.append(_code(command))
    os.write(writing, f"code {codes[0]}\n".encode())
    sys.exit(codes[0])


def _end(codes: list[int]) -> None:
    """End the process without taking the interpreter apart, which costs as much as many imports.

    This function is registered first and therefore called last: threads have been joined, and the
    other functions registered with atexit have been called.
    """
    if not codes:  # not the end of `_work`: an FMU has called exit()
        return
    ctypes.CDLL(None).fflush(None)  # what C code has printed
    os._exit(codes[0])


def _code(command: Callable[[], None]) -> int:
    """The exit code of a command, as the interpreter would have it."""
    try:
        with signals_as_interrupt():
            command()
        code: int | str | None = 0
    except SystemExit as end:
        code = end.code
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        code = exit_code()
    except BrokenPipeError:  # nobody reads any more
        code = 1
    except BaseException as error:
        if lacking := shortage(error):
            sys.stderr.write(f"error: {lacking}\n")
        else:
            sys.excepthook(type(error), error, error.__traceback__)
        code = 1
    sys.stderr.flush()
    return complete_output(code if isinstance(code, int) else int(code is not None))


def _wait(child: int, signals: set[signal.Signals]) -> int:
    """Pass signals on until the child has ended; its wait status."""
    while True:
        number = signal.sigwait(signals)
        if number == signal.SIGCHLD:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return status
        elif number == signal.SIGTSTP:
            os.kill(child, signal.SIGSTOP)
            os.kill(os.getpid(), signal.SIGSTOP)
        else:
            os.kill(child, number)


def _finish_folder(status: int, folder: str) -> int:
    """Report how the child ended, and complete the folder it has left; return the exit code."""
    code = 1
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) in ENDING:  # before it could take note
        how, code = "interrupted", 128 + os.WTERMSIG(status)
    elif os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        how = f"the process of this command was ended by {name}"
        how += (
            " (a component crashed; isolate = true tells which FMU does)"
            if name in _CRASHES
            else ""
        )
        how += " (by somebody, or for lack of memory)" if name == "SIGKILL" else ""
    else:
        said = os.WEXITSTATUS(status)
        how = f"a component or a library ended the process of this command (exit code {said})"
    sys.stderr.write(f"error: {how}\n" if code == 1 else f"{how}\n")
    sys.stderr.flush()  # what ended the child, as a lack of memory, may end this process as well
    if folder and Path(folder).exists():
        _complete(Path(folder), how)
    return code


def _complete(folder: Path, how: str) -> None:
    try:
        from cosim.engine.recovery import repair

        if until := repair(folder, how):
            sys.stderr.write(f"{until}: {folder}\n")
    except CosimError as error:
        sys.stderr.write(f"error: {error}\n")
    except Exception as error:
        if not (lacking := shortage(error)):
            raise
        sys.stderr.write(f"error: {lacking}; `cosim report {folder} --recover` completes it\n")


_CRASHES = {"SIGSEGV", "SIGBUS", "SIGFPE", "SIGILL", "SIGABRT"}
