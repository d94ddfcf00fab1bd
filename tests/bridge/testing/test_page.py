"""The page about tests: its program passes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bridge.scaffold import write_controller
from tests.bridge.testing import loaded

pytest_plugins = ["pytester"]
PAGE = Path(__file__).resolve().parents[3] / "docs" / "testing.md"
loaded.all_that_runs_use()


def test_the_program_of_the_page_passes(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider")
    write_controller("my_law", pytester.path)
    program = re.search(
        r"<!-- file (\S+) -->\n```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    assert program
    (pytester.path / program[1]).write_text(program[2], encoding="utf-8")
    tests = program[2].count("def test_")
    pytester.runpytest("--cosim-update", program[1]).assert_outcomes(passed=tests)
    pytester.runpytest(program[1], "-k", "nothing_has_changed").assert_outcomes(
        passed=1, deselected=tests - 1
    )
