"""The verdicts of a kit as text, and as JUnit XML for a CI server."""

from __future__ import annotations

import os
from pathlib import Path
from textwrap import wrap
from xml.etree import ElementTree

from bridge.conform.rules import Conformity, ConformityReport, ConformityRule, JudgedRule
from cosim.base.errors import RunError

WIDTH = 100
_DETAILED = (Conformity.FAILED, Conformity.INCONCLUSIVE)


def report_lines(report: ConformityReport) -> list[str]:
    """The printed table; a rule that did not pass has its clause, what was expected and what came
    below it.
    """
    widest = max((len(j.rule.title) for j in report.judged), default=0)
    lines = [report.subject]
    for j in report.judged:
        lines.append(f"{j.rule.number}  {j.rule.title:<{widest}}  {j.verdict}")
        if j.verdict in _DETAILED:
            lines += _detail("clause", clause_of(j.rule))
            lines += _detail("expected", j.rule.expected)
            lines += _detail("came", _came(j))
        elif j.verdict is Conformity.NOT_APPLICABLE and j.came:
            lines += _detail("because", j.came)
    return [*lines, f"verdict: {report.sentence()}"]


def clause_of(rule: ConformityRule) -> str:
    """The page of the documentation that demands a rule, or a vendor's document or a standard."""
    return f"docs/{rule.clause}" if ".md" in rule.clause else rule.clause


def _came(judged: JudgedRule) -> str:
    late = f"; the kit itself was late by up to {judged.late_ms:.1f} ms"
    return judged.came + (late if judged.late_ms >= 1.0 else "")


def _detail(what: str, text: str) -> list[str]:
    start = f"      {what:<9}"
    rest = " " * len(start)
    return wrap(text, WIDTH, initial_indent=start, subsequent_indent=rest, break_on_hyphens=False)


def write_conformity_junit(report: ConformityReport, path: Path) -> Path:
    """Write a test case for each rule: failed as a failure, inconclusive as an error, not
    applicable as skipped. Raises RunError if the file cannot be written.
    """
    suite = ElementTree.Element(
        "testsuite",
        name=f"cosim conform {report.subject}",
        tests=str(len(report.judged)),
        failures=str(report.count(Conformity.FAILED)),
        errors=str(report.count(Conformity.INCONCLUSIVE)),
        skipped=str(report.count(Conformity.NOT_APPLICABLE)),
        time=f"{report.seconds:.3f}",
    )
    for j in report.judged:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=f"cosim.conform.{j.rule.clause}",
            name=f"{j.rule.number} {j.rule.title}",
            time=f"{j.seconds:.3f}",
        )
        text = f"expected: {j.rule.expected} Came: {_came(j)}"
        match j.verdict:
            case Conformity.FAILED:
                ElementTree.SubElement(case, "failure", message=text)
            case Conformity.INCONCLUSIVE:
                ElementTree.SubElement(case, "error", message=text)
            case Conformity.NOT_APPLICABLE:
                ElementTree.SubElement(case, "skipped", message=j.came)
            case Conformity.PASSED:
                pass
    try:
        ElementTree.ElementTree(suite).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise RunError(f"cannot write {path}: {os.strerror(error.errno or 0)}") from error
    return path
