"""A shortage of resources gives a sentence; an error of the program is not changed."""

from __future__ import annotations

import errno
import os

import pytest

from cosim.base.errors import NO_REASON, NO_THREAD, shortage


def unloadable(name: str, path: str) -> ImportError:
    return ImportError("failed to map segment from shared object", name=name, path=path)


def packaged() -> ImportError:
    """As a package says it that looks for an optional part of itself."""
    try:
        try:
            raise unloadable("_parquet", "/lib/_parquet.so")
        except ImportError:
            raise ImportError("not built with support for Parquet") from None
    except ImportError as error:
        return error


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), "there is not enough memory for this"),
        (OSError(errno.EMFILE, os.strerror(errno.EMFILE), "/a"), "/a: Too many open files"),
        (OSError(errno.EMFILE, os.strerror(errno.EMFILE)), "the system: Too many open files"),
        (RuntimeError(NO_THREAD), "not enough memory, or too many threads"),
        (SystemError(NO_REASON), "not enough memory, or a library that fails"),
        (unloadable("x", "/lib/x.so"), "a library cannot be loaded: failed to map segment"),
        (packaged(), "a library cannot be loaded: failed to map segment"),
    ],
)
def test_what_is_short_is_said(error: Exception, said: str) -> None:
    assert shortage(error).startswith(said)


@pytest.mark.parametrize(
    "error",
    [
        ModuleNotFoundError("no module", name="x"),
        ImportError("cannot import name", name="x", path="/lib/x.py"),
        RuntimeError("another"),
        SystemError("another"),
        KeyError("x"),
    ],
)
def test_errors_of_the_program_are_not_hidden(error: Exception) -> None:
    assert shortage(error) == ""
