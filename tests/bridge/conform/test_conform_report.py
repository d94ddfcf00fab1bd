"""Verdicts of a kit: which one a report has, as text, JSON and JUnit."""

from xml.etree import ElementTree

import pytest

from bridge.conform.report import report_lines, write_conformity_junit
from bridge.conform.rules import Conformity, ConformityReport, ConformityRule, JudgedRule, RuleBook
from cosim.base.errors import ScenarioError

RULES = [
    ConformityRule(f"X-0{n}", f"rule {n}", "can.md#messages", "Frames are fine.") for n in (2, 1)
]


def report(*verdicts):
    return ConformityReport(
        "a device", [JudgedRule(RULES[0], v, "byte 3 is 7", 2.0) for v in verdicts]
    )


@pytest.mark.parametrize(
    ("verdicts", "whole", "code"),
    [
        ("passed", "passed", 0),
        ("passed failed inconclusive", "failed", 1),
        ("passed inconclusive", "inconclusive", 3),
        ("passed,not applicable", "passed", 0),
        ("not applicable", "inconclusive", 3),
        ("", "inconclusive", 3),
    ],
)
def test_the_worst_verdict_counts(verdicts, whole, code):
    words = [verdicts] if verdicts == "not applicable" else verdicts.replace(",", "|").split("|")
    words = [w for word in words for w in ([word] if word == "not applicable" else word.split())]
    found = report(*map(Conformity, words))
    assert (found.verdict, found.exit_code) == (whole, code)


def test_rules_are_sorted_selected_and_named():
    book = RuleBook(RULES)
    assert [r.number for r in book.rules] == ["X-01", "X-02"]
    assert [r.number for r in book.selected("x-02")] == ["X-02"]
    assert book.selected("") == book.rules
    with pytest.raises(ScenarioError, match="X-01"):
        book.selected("X-1")
    with pytest.raises(ValueError, match="X-01"):
        RuleBook([*RULES, RULES[1]])


def test_text_has_clause_expectation_and_what_came():
    text = "\n".join(report_lines(report(Conformity.FAILED, Conformity.PASSED)))
    assert "docs/can.md#messages" in text
    assert "Frames are fine." in text
    assert "byte 3 is 7; the kit itself was late by up to 2.0 ms" in text
    assert text.endswith("verdict: failed: 1 passed, 1 failed in 0.0 s")


def test_junit_counts_each_verdict(tmp_path):
    found = report(*Conformity)
    suite = ElementTree.parse(write_conformity_junit(found, tmp_path / "x.xml")).getroot()
    counts = {key: suite.get(key) for key in ("tests", "failures", "errors", "skipped")}
    assert counts == {"tests": "4", "failures": "1", "errors": "1", "skipped": "1"}
    assert [len(case) for case in suite] == [0, 1, 1, 1]
    assert "byte 3 is 7" in suite[1][0].get("message")
