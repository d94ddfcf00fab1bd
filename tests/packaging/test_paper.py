"""The paper about the package: its numbers are those of its script, its references are there."""

from __future__ import annotations

import re

import yaml

from docs.evidence import paper_numbers as script

TEXT = script.PAGE.read_text(encoding="utf-8")


def test_the_numbers_are_current() -> None:
    found = script.numbers()
    assert set(script.NUMBER.findall(TEXT)) == set(found), "a number is not in the text"
    assert script.written(TEXT, found) == TEXT, "python docs/evidence/paper_numbers.py"


def test_each_reference_is_cited_and_each_citation_is_a_reference() -> None:
    bibliography = (script.ROOT / "paper.bib").read_text(encoding="utf-8")
    entries = re.findall(r"^@\w+\{(\w+),", bibliography, re.MULTILINE)
    assert len(entries) == len(set(entries))
    assert set(re.findall(r"@(\w+)", TEXT.split("---", 2)[2])) == set(entries)


def test_it_has_what_the_journal_asks_for() -> None:
    head = yaml.safe_load(TEXT.split("---")[1])
    assert head["bibliography"] == "paper.bib" and head["tags"] and head["affiliations"]
    sections = re.findall(r"^# (.+)", TEXT, re.MULTILINE)
    assert sections == [
        "Summary", "Statement of need", "State of the field", "Software design",
        "Research impact statement", "AI usage disclosure", "References",
    ]  # fmt: skip
    words = len(re.sub(r"<!--.*?-->", "", TEXT.split("---", 2)[2]).split())
    assert 750 <= words <= 1750
