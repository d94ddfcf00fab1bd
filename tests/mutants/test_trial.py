"""A run of tests that never began is no test that has noticed something."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants.trial import Selection, run


def test_tests_that_cannot_begin_are_an_error_and_no_failure(tmp_path: Path) -> None:
    """A plugin that cannot be loaded ends pytest as a file that is not there does."""
    with pytest.raises(SystemExit, match="pytest does not begin"):
        run([str(tmp_path / "test_no_such.py")], Selection(), tmp_path / "log", 60)


def test_a_test_that_fails_is_named(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text("def test_one(): pass\ndef test_two(): assert 0\n")
    found = run([str(tmp_path / "test_it.py")], Selection(), tmp_path / "log", 60)
    assert [name.rpartition("::")[2] for name in found.failures] == ["test_two"]
