"""What C writes down of what an FMU logs, called as an FMU calls it."""

from __future__ import annotations

import ctypes as c
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from cosim.native import fmu_log, shared


@contextmanager
def opened(log: fmu_log.Log) -> Iterator[c.c_void_p]:
    """The environment of a log that is open, as FMUs are given it."""
    shared.library().engine_log_open(b"x", c.byref(log))
    yield c.c_void_p(c.addressof(log))
    shared.library().engine_log_close(c.byref(log))


@pytest.mark.parametrize(
    ("status", "name"), [(0, "ok"), (4, "fatal"), (5, "pending"), (6, "unknown"), (-1, "unknown")]
)
def test_a_line_begins_with_the_name_of_its_status(status: int, name: str) -> None:
    log = fmu_log.log(room=100)
    with opened(log) as at:
        shared.library().engine_log3(at, status, b"category", b"text")
    assert log.text() == f"[{name}] category: text\n"
    assert list(log.level[:1]) == [status]


@pytest.mark.parametrize(("short", "text"), [(0, "[ok] a: b\n" * 2), (1, "[ok] a: b\n")])
def test_a_line_is_kept_where_there_is_room_for_it_and_the_zero_behind_it(short: int, text: str):
    """A line that does not fit is counted and left out as a whole."""
    log = fmu_log.log(room=len("[ok] a: b\n" * 2) + 1 - short)
    with opened(log) as at:
        for _ in range(2):
            shared.library().engine_log3(at, 0, b"a", b"b")
    left_out = "... 1 lines left out; the last ones:\nb\nb\n"
    assert log.text() == text + (left_out if short else "")
    assert log.dropped == short
