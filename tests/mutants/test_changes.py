"""Mutants are made of code only, each is another text, and those said to be equivalent exist."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.mutants.__main__ import ROOT, chosen
from tests.mutants.changes import equivalent, mutants
from tests.mutants.groups import GROUPS

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
    found = list(mutants(file, tmp_path))
    assert [m.old for m in found] == changes
    assert len({m.apply(text) for m in found} - {text}) == len(changes)
    assert found[0].said(tmp_path).startswith(name)


@pytest.mark.parametrize("name", GROUPS)
def test_every_group_has_sources_and_tests(name: str) -> None:
    group = GROUPS[name]
    assert all((ROOT / path).exists() for path in group.tests)
    assert len(group.mutants(ROOT)) > 100


def test_the_same_seed_chooses_the_same_mutants() -> None:
    assert chosen("links", 20, 1, "") == chosen("links", 20, 1, "")
    assert chosen("links", 20, 1, "") != chosen("links", 20, 2, "")
    assert {m.file.name for m in chosen("bridge", 500, 1, "dispatch.c:")} == {"dispatch.c"}


def test_each_equivalent_mutant_exists_and_has_a_reason() -> None:
    made = {m.key(ROOT) for group in GROUPS.values() for m in group.mutants(ROOT)}
    assert set(equivalent()) <= made
    assert all(why.endswith(".") for why in equivalent().values())
