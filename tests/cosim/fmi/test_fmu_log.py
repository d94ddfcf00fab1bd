"""What C writes down of what an FMU logs, called as an FMU calls it."""

from __future__ import annotations

import ctypes as c

import pytest

from cosim.native import fmu_log, structs


@pytest.mark.parametrize(
    ("status", "name"), [(0, "ok"), (4, "fatal"), (5, "pending"), (6, "unknown"), (-1, "unknown")]
)
def test_a_line_begins_with_the_name_of_its_status(status: int, name: str) -> None:
    log = fmu_log.log(room=100)
    structs.library().engine_log3(c.c_void_p(c.addressof(log)), status, b"category", b"text")
    assert log.text() == f"[{name}] category: text\n"
    assert list(log.level[:1]) == [status]
