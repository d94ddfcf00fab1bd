"""The table of docs/faults.md names tests that are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
TITLE = "## Findings of an independent test"


def test_every_test_that_the_table_names_is_there() -> None:
    section = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8").split(TITLE)[1]
    rows = [line for line in section.split("\n## ")[0].splitlines() if line.startswith("| ")]
    assert len(rows) > 30
    for row in rows[1:]:
        named = re.findall(r"((?:tests|benchmarks)/[\w/]+\.py)(?:`?::`?(\w+))?", row)
        assert named, row
        for file, function in named:
            text = (ROOT / file).read_text(encoding="utf-8")
            assert not function or f"def {function}(" in text, f"{file}::{function}"
