"""The page about analysis and pre-flight names every rule there is, and no other."""

from __future__ import annotations

import re
from pathlib import Path

from tests.cli.command import ROOT

PAGE = (ROOT / "docs" / "analysis.md").read_text("utf-8")


def test_every_rule_is_in_the_table_and_every_row_is_a_rule() -> None:
    sources = "".join(p.read_text("utf-8") for p in Path(ROOT / "cosim" / "checks").glob("*.py"))
    rules = set(re.findall(r'rule="([a-z-]+)"', sources))
    rules |= set(re.findall(r'_note\(\s*"([a-z-]+)"', sources))
    table = PAGE.split("## 4.")[1].split("## 5.")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert rules == {name for row in rows for name in re.findall(r"`([a-z-]+)`", row)}
