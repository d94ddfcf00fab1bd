"""Names: a class name means one thing in all production code."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


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
