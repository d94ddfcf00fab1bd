"""The page of the rules is that of the rules, and each clause is a section that exists."""

import importlib.util
import re
from pathlib import Path

import pytest

from bridge.conform.participant import PARTICIPANT_RULES

ROOT = Path(__file__).resolve().parents[3]
SPEC = importlib.util.spec_from_file_location("conform_rules", ROOT / "docs" / "conform_rules.py")
conform_rules = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(conform_rules)


def anchors(page):
    heads = re.findall(r"^#+ (.+)$", (ROOT / "docs" / page).read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", conform_rules.BOOKS, ids=lambda path: path.name)
def test_a_page_is_current(path):
    said = path.read_text("utf-8")
    assert said == conform_rules.page(path), "python docs/conform_rules.py writes it"


@pytest.mark.parametrize("rule", PARTICIPANT_RULES.rules, ids=lambda rule: rule.number)
def test_a_clause_is_a_section(rule):
    page, _, section = rule.clause.partition("#")
    assert section in anchors(page)
    assert rule.expected.endswith(".")
