"""Names: a class name means one thing in production code, and the glossary names what is there."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@lru_cache(maxsize=1)
def classes() -> dict[str, list[str]]:
    """Where each class of production code is defined, ``FILE:LINE``, by name."""
    found: dict[str, list[str]] = defaultdict(list)
    for package in ("cosim", "bridge", "fmus"):
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    found[node.name].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    return found


def test_no_class_name_is_defined_twice():
    assert {name: places for name, places in classes().items() if len(places) > 1} == {}


GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in GLOSSARY.splitlines()
    if line.startswith("| ") and not line.startswith("| word")
]


@pytest.mark.parametrize(("word", "meaning", "where"), ROWS, ids=[row[0] for row in ROWS])
def test_a_word_of_the_glossary_lives_where_it_says(word, meaning, where):
    assert word and meaning.endswith((".", "…"))
    found = classes()
    places = re.findall(r"(?:`(\w+)` in )?`(\w+/[\w/]+\.\w+)`", where)
    assert places, f"{word}: expected a file"
    for name, path in places:
        assert (ROOT / path).is_file(), f"{word}: {path}"
        if name:
            assert [p.partition(":")[0] for p in found.get(name, [])] == [path], f"{word}: {name}"


def test_the_glossary_has_each_word_once():
    words = [row[0] for row in ROWS]
    assert len(words) == len(set(words)) >= 40
    assert "(glossary.md)" in (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
