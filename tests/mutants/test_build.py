"""What a change reaches is compiled again, and nothing else; a child's end is told in time."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from fmus.build import toolchain
from tests.children import FAILED
from tests.mutants.trial import Selection, forked, run
from tests.objects import keep, texts

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


def test_only_what_is_new_is_compiled_and_linked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    real = toolchain._run
    monkeypatch.setattr(
        toolchain, "_run", lambda command, what: (calls.append(what), real(command, what))
    )
    keep(tmp_path / "objects", monkeypatch.setattr)
    sources = [tmp_path / "a.c", tmp_path / "b.c"]
    sources[0].write_text('#include "c.h"\nint a = C;\n')
    sources[1].write_text("int b;\n")
    new = []
    for value in (1, 2, 1, 1):
        (tmp_path / "c.h").write_text(f"#define C {value}\n")
        toolchain.compile_shared(sources, tmp_path / f"{len(new)}" / "x.so", flags=["-DA"])
        new.append(sorted(call.split()[0] for call in calls if call != "a probe"))
        calls.clear()
    assert new == [["a.c", "b.c", "x.so"], ["a.c", "x.so"], [], []]
    toolchain.compile_shared(sources, tmp_path / "x.so", flags=["-DB"])
    assert len(calls) == 3
    first, second, third = ((tmp_path / f"{n}/x.so").read_bytes() for n in range(3))
    assert first == third != second


def test_the_same_objects_with_another_library_are_linked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep(tmp_path / "objects", monkeypatch.setattr)
    (tmp_path / "a.c").write_text("int a;\n")
    part = toolchain.compile_object(tmp_path / "a.c", tmp_path / "a.o")
    toolchain.link_shared([part], tmp_path / "x.so", libraries=["m"])
    with pytest.raises(toolchain.ToolchainError, match="no_such_one"):
        toolchain.link_shared([part], tmp_path / "x.so", libraries=["no_such_one"])


@pytest.mark.parametrize(
    ("work", "limit", "code"),
    [
        (lambda pipe: 3, 60.0, 3),
        (lambda pipe: os.kill(os.getpid(), signal.SIGTERM), 60.0, -signal.SIGTERM),
        (lambda pipe: time.sleep(60), 0.2, -signal.SIGKILL),
        (lambda pipe: None, 60.0, FAILED),
        (lambda pipe: 1 // 0, 60.0, FAILED),
        (lambda pipe: signal.raise_signal(signal.SIGINT), 60.0, FAILED),
        (lambda pipe: pytest.skip("not here"), 60.0, FAILED),
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
        pytest.param("assert True", "", marks=pytest.mark.slow),
        pytest.param("assert False", "::test_it", marks=pytest.mark.slow),
        ("import os; os.kill(os.getpid(), 9)", "::test_it (no end)"),
    ],
)
def test_the_failing_test_is_named(tmp_path: Path, body: str, failed: str) -> None:
    (tmp_path / "test_a.py").write_text(f"def test_it():\n    {body}\n")
    found = run([str(tmp_path / "test_a.py")], NOTHING, tmp_path / "log", 60.0).failures
    assert bool(found) == bool(failed)
    assert not found or found[0].endswith(failed)
