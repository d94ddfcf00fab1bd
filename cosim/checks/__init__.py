"""Pre-flight: checks of a scenario before it runs, with advice.

``preflight.check(scenario, plan)`` gives findings, worst first. Rules are functions of a
:class:`cosim.predict.system.AnalyzedSystem`, a file a subject:

================  =================================================================
``reachability``  robots: reached from the operator's arm, with senders, within their limits
``loops``         the run from the start, and the poles of the whole loop where robots rest
``ports``         passivity of ports, how long a hand takes
``laws``          degenerate gains, gravity, what can be predicted
``channels``      links: bounded delays, losses, order, buffers, CAN buses
``receivers``     links: queues that grow, values of one sender that are not of one time
``wiring``        unconnected inputs, size of what is recorded
``requirements``  conditions that cannot fail, cannot hold, or are of times after the run
================  =================================================================

Only ``loops`` and ``ports`` run the scenario, in memory; nothing here stops a run.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from math import isfinite
from typing import Any, Literal

from cosim.base.convert import Struct
from cosim.base.copies import replace
from cosim.base.names import NAMES, counted, listed

Severity = Literal["error", "warning", "note"]

#: From worst to least.
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")


class Finding(Struct, frozen=True, kw_only=True):
    """A finding of a rule about `where` (components, links, or a table of the scenario).

    `number` in `unit` is the value that was checked; `reason` gives its meaning and the limit;
    `advice` is a possible change, "" if none is needed.
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
    """Findings, worst first; equal texts about several places become one finding.

    So do those that differ in their advice, too, where more than NAMES places have them; the advice
    is the one for the first of these.
    """
    found = list(findings)
    kinds = [replace(f, where="", advice="") for f in found]
    counts = Counter(kinds)
    alike: dict[Finding, list[Finding]] = {}
    for f, kind in zip(found, kinds, strict=True):
        many = counts[kind] > NAMES
        alike.setdefault(kind if many else replace(f, where=""), []).append(f)
    together = [replace(same[0], where=_places(same)) for same in alike.values()]
    return tuple(sorted(together, key=lambda f: SEVERITIES.index(f.severity)))


def _places(findings: Iterable[Finding]) -> str:
    places = list(dict.fromkeys(f.where for f in findings))
    return listed(sorted(places, key=counted) if len(places) > NAMES else places)
