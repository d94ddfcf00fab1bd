"""What a change reaches is compiled again, and nothing else; a child's end is told in time."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from tests.mutants.build import texts
from tests.mutants.trial import Selection, forked, run

NOTHING = Selection()


def test_an_object_depends_on_the_headers_that_headers_include(tmp_path: Path) -> None:
    (tmp_path / "a.c").write_text('#include "b.h"\n#include <stdio.h>\n')
    (tmp_path / "b.h").write_text('#  include "c.h"\n')
    (tmp_path / "c.h").write_text('#include "b.h"\n')
    (tmp_path / "d.h").write_text("not reached\n")
    before = texts(tmp_path / "a.c", [tmp_path])
    assert len(before) == 3
    (tmp_path / "c.h").write_text("changed\n")
    assert texts(tmp_path / "a.c", [tmp_path]) != before


@pytest.mark.parametrize(
    ("work", "limit", "code"),
    [
        (lambda pipe: 3, 60.0, 3),
        (lambda pipe: os.kill(os.getpid(), signal.SIGTERM), 60.0, -signal.SIGTERM),
        (lambda pipe: time.sleep(60), 0.2, -signal.SIGKILL),
    ],
)
def test_a_child_that_crashes_or_stands_still_is_noticed(
    tmp_path: Path, work: object, limit: float, code: int
) -> None:
    begin = time.monotonic()
    assert forked(work, tmp_path / "log", limit)[0] == code  # type: ignore[arg-type]
    assert time.monotonic() - begin < 30


@pytest.mark.parametrize(
    ("body", "failed"),
    [
        ("assert True", ""),
        ("assert False", "::test_it"),
        ("import os; os.kill(os.getpid(), 9)", "::test_it (no end)"),
    ],
)
def test_the_failing_test_is_named(tmp_path: Path, body: str, failed: str) -> None:
    (tmp_path / "test_a.py").write_text(f"def test_it():\n    {body}\n")
    found = run([str(tmp_path / "test_a.py")], NOTHING, tmp_path / "log", 60.0).failures
    assert bool(found) == bool(failed)
    assert not found or found[0].endswith(failed)
