"""What a file of tests does is measured once, and again when the file or the sources change."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants import measure
from tests.mutants.measure import Measurement

pytestmark = pytest.mark.slow
SOURCE = """\
__attribute__((visibility("default"))) int f(int x)
{
    if (x > 1) {
        return 2;
    }
    return 1;
}
"""
TESTS = """\
import ctypes
from pathlib import Path

from fmus.build.toolchain import compile_shared

HERE = Path(__file__).parent
f = ctypes.CDLL(str(compile_shared([HERE / "a.c"], HERE / "a.so"))).f


def test_low():
    assert f(0) == 1


def test_high():
    assert f(2) == 2


def test_wrong():
    assert f(0) == 2
"""


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A checkout of one C file and one file of tests, which compiles it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(measure, "compiled", lambda root, log: None)
    (tmp_path / "a.c").write_text(SOURCE)
    (tmp_path / "test_a.py").write_text(TESTS)
    return tmp_path


def test_times_blocks_and_failures_are_measured(root: Path) -> None:
    found = Measurement(root, root, [Path("a.c")]).of(["."])["test_a.py"]
    executed = {test.rpartition("::")[2]: numbers for test, numbers in found.executed.items()}
    assert executed == {"": [], "test_low": [1], "test_high": [0, 1], "test_wrong": [1]}
    assert [test.rpartition("::")[2] for test in found.failures] == ["test_wrong"]
    assert len(found.seconds) == 3
    assert (root / "a.c").read_text() == SOURCE


def test_only_what_has_changed_is_measured_again(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (root / "test_a.py").write_text("def test_it():\n    pass\n")
    (root / "test_b.py").write_text("def test_it():\n    pass\n")
    runs: list[str] = []
    real = measure.run

    def counted(tests: list[str], *more: object, **named: object) -> object:
        runs.extend(tests)
        return real(tests, *more, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(measure, "run", counted)
    for changed, text in [("", ""), ("", ""), ("test_b.py", "def test_other(): pass")]:
        if changed:
            (root / changed).write_text(text)
        Measurement(root, root, [Path("a.c")]).of(["."])
    assert runs == ["test_a.py", "test_b.py", "test_b.py"]
    (root / "a.c").write_text(SOURCE + "\n")
    Measurement(root, root, [Path("a.c")]).of(["."])
    assert runs[3:] == ["test_a.py", "test_b.py"]
