"""Mutants are made of code only, and each is another text."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants.__main__ import GROUPS, ROOT
from tests.mutants.changes import mutants

C = """#if A < B
/* a < b */
static int f(int a, int b) // a + b
{
    if (a < b && say("x == y")) return 0;
    return 1;
}
"""
PYTHON = '''"""a < b"""
def f(a, b):
    return a - b if a is None else "c + d"  # or
'''


@pytest.mark.parametrize(
    ("name", "text", "changes"),
    [("x.c", C, [" < ", " && ", "return 0;", "return 1;"]), ("x.py", PYTHON, [" - ", " is None"])],
)
def test_comments_texts_and_directives_stay(
    tmp_path: Path, name: str, text: str, changes: list[str]
) -> None:
    file = tmp_path / name
    file.write_text(text)
    found = list(mutants(file))
    assert [m.old for m in found] == changes
    assert len({m.apply(text) for m in found} - {text}) == len(changes)
    assert found[0].said(text, tmp_path).startswith(name)


@pytest.mark.parametrize("name", GROUPS)
def test_every_group_has_sources_and_tests(name: str) -> None:
    group = GROUPS[name]
    assert all((ROOT / path).is_dir() for path in group.tests)
    assert sum(len(list(mutants(file))) for file in group.files(ROOT)) > 100
