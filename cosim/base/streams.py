"""Standard streams that are closed, full, or read by nobody.

A closed stream acts as /dev/null: what was not wanted is not missed, and no other file gets its
number. What cannot be written to standard output ends the program with an error. Notes for which
standard error has no room are lost; they change neither the work nor the exit code.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from typing import Any, BinaryIO, NoReturn, TextIO, cast, final

from cosim.base.errors import shortage

_NAMES = ("standard input", "standard output", "standard error")


@final
class _Output(io.FileIO):
    """Standard output: an error of the system names it."""

    def write(self, data: Any, /) -> int:
        """Write, or raise OSError."""
        try:
            return super().write(data)
        except OSError as error:
            error.filename = _NAMES[1]
            raise


@final
class _Notes(io.FileIO):
    """Standard error: what it cannot take is dropped."""

    def write(self, data: Any, /) -> int:
        """Write, or drop; the number of bytes."""
        try:
            return super().write(data) or len(data)
        except OSError:
            return len(data)


def open_standard_streams() -> None:
    """Prepare the streams of this process; to be called before it opens any other file."""
    for number in range(len(_NAMES)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets this number, the lowest that is free
            os.set_inheritable(number, True)
    if sys.stdin is None:
        sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0, closefd=False)))
    sys.stdout = _text(_Output(1, "w", closefd=False), sys.stdout)
    sys.stderr = _text(_Notes(2, "w", closefd=False), sys.stderr)


def _text(file: io.FileIO, before: TextIO | None) -> TextIO:
    """A text stream into `file`, with the settings of the one before."""
    if not isinstance(before, io.TextIOWrapper):
        return io.TextIOWrapper(io.BufferedWriter(file), encoding="utf-8")
    return io.TextIOWrapper(
        # a file without a buffer is what PYTHONUNBUFFERED asks for
        cast("BinaryIO", file) if before.write_through else io.BufferedWriter(file),
        encoding=before.encoding,
        errors=before.errors,
        line_buffering=before.line_buffering,
        write_through=before.write_through,
    )


def complete_output(code: int) -> int:
    """Write what standard output still holds; the exit code: `code`, or 1 if that fails."""
    try:
        sys.stdout.flush()
        return code
    except OSError as error:
        with open(os.devnull, "wb") as null:  # the interpreter will try again
            os.dup2(null.fileno(), 1)
        return code or report(error)


def report(error: OSError) -> int:
    """Report an error of the system, unless it is that nobody reads any more; the exit code."""
    if not isinstance(error, BrokenPipeError):
        sys.stderr.write(f"error: {shortage(error)}\n")
    return 1


def end_with(program: Callable[[], int]) -> NoReturn:
    """Prepare the streams, call a program that is no command of cosim, and exit with its code."""
    open_standard_streams()
    try:
        code = program()
    except OSError as error:
        code = report(error)
    sys.exit(complete_output(code))
