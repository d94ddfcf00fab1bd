"""The page about tests: its program passes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bridge.scaffold import write_controller
from tests.bridge.testing import loaded

pytest_plugins = ["pytester"]
PAGE = Path(__file__).resolve().parents[3] / "docs" / "testing.md"
_PROGRAM = re.compile(r"<!-- file (\S+) -->\n```python\n(.*?)```", re.DOTALL)
loaded.all_that_runs_use()


def test_the_programs_of_the_page_pass(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider")
    write_controller("my_law", pytester.path)
    programs = dict(_PROGRAM.findall(PAGE.read_text(encoding="utf-8")))
    assert {"test_arm.py", "test_frames.py"} <= programs.keys()
    for name, text in programs.items():
        (pytester.path / name).write_text(text, encoding="utf-8")
    tests = sum(text.count("def test_") for text in programs.values())
    pytester.runpytest("--cosim-update", *programs).assert_outcomes(passed=tests)
    again = pytester.runpytest("test_arm.py", "-k", "nothing_has_changed")
    again.assert_outcomes(passed=1, deselected=programs["test_arm.py"].count("def test_") - 1)
