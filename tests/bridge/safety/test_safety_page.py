"""``docs/safety.md`` has every guard and reason, and its evidence names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

from bridge.native.safety import GuardBit, Why

HERE = Path(__file__).resolve().parents[1]  # tests/bridge
DOCS = HERE.parents[1] / "docs"
PAGE = (DOCS / "safety.md").read_text(encoding="utf-8")
EVIDENCE = (DOCS / "evidence" / "safety.md").read_text(encoding="utf-8")


def test_every_test_it_names_exists() -> None:
    named = re.findall(r"`([./\w]+\.py)::(\w+)`", EVIDENCE)
    assert len(named) > 20
    for file, test in named:
        assert f"def {test}(" in (HERE / file).read_text(encoding="utf-8"), test


def test_every_guard_and_every_reason_is_on_it() -> None:
    for bit in (*GuardBit, *Why):
        assert f"| {(bit.name or '').lower()} |" in PAGE, bit
