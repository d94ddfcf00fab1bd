"""A finding: how bad, where, the number, the reason, what to change."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, Literal

Severity = Literal["error", "warning", "note"]

#: From worst to least.
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What a rule says of `where` (components, links, or a table of the scenario).

    `number` in `unit` is what was looked at; `reason` says what it means, with what it was compared
    to; `advice` what to change, "" where nothing has to be.
    """

    rule: str
    severity: Severity
    where: str
    number: float
    unit: str
    reason: str
    advice: str = ""

    @property
    def line(self) -> str:
        """On one line: severity, place, reason; without the advice."""
        return f"{self.severity}: {self.where}: {self.reason} [{self.rule}]"

    def as_data(self) -> dict[str, Any]:
        """For JSON; a number that is infinite is a text, one that is missing null."""
        number = self.number
        plain = number if isfinite(number) else None if number != number else str(number)
        return {
            "rule": self.rule,
            "severity": self.severity,
            "where": self.where,
            "number": plain,
            "unit": self.unit,
            "reason": self.reason,
            "advice": self.advice,
        }


def merge_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Worst first; what is said of several in the same words is said once."""
    places: dict[Finding, list[str]] = {}
    for f in findings:
        places.setdefault(replace(f, where=""), []).append(f.where)
    together = [replace(f, where=", ".join(dict.fromkeys(where))) for f, where in places.items()]
    return tuple(sorted(together, key=lambda f: SEVERITIES.index(f.severity)))
