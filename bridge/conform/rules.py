"""A rule of a kit, its verdict, and all verdicts of one kit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, final

from cosim.base.errors import ScenarioError
from cosim.base.names import unknown


class Conformity(StrEnum):
    """The verdict of a rule."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"
    INCONCLUSIVE = "inconclusive"


#: The verdict of a whole kit is the first of these that a rule has.
_WORST = (Conformity.FAILED, Conformity.INCONCLUSIVE, Conformity.PASSED)
EXIT_CODES = {
    Conformity.PASSED: 0,
    Conformity.FAILED: 1,
    Conformity.INCONCLUSIVE: 3,
    Conformity.NOT_APPLICABLE: 3,
}


@dataclass(frozen=True, slots=True)
class ConformityRule:
    """A numbered rule, such as C-07, which never changes its number.

    `clause`: page and section of the documentation that demands it, ``can.md#protection``;
    `expected`: one sentence, in the present tense. `part`: of a participant that may be left out,
    "": none (``participants.md``).
    """

    number: str
    title: str
    clause: str
    expected: str
    part: str = ""


@dataclass(frozen=True, slots=True)
class JudgedRule:
    """The verdict of a rule. `came`: the bytes, states and times that it is based on.

    `late_ms`: by how much the kit itself was late meanwhile, ms. `seconds`: the time it took.
    """

    rule: ConformityRule
    verdict: Conformity
    came: str = ""
    late_ms: float = 0.0
    seconds: float = 0.0


@final
class RuleBook:
    """The rules of one kit, in the order of their numbers. Raises ValueError for a number twice."""

    def __init__(self, rules: Iterable[ConformityRule]) -> None:
        self.rules = tuple(sorted(rules, key=lambda rule: rule.number))
        self._by_number = {rule.number: rule for rule in self.rules}
        twice = [n for n, count in Counter(rule.number for rule in self.rules).items() if count > 1]
        if twice:
            raise ValueError(f"rule {', '.join(twice)}: expected each number once")

    def __getitem__(self, number: str) -> ConformityRule:
        return self._by_number[number]

    def selected(self, text: str) -> tuple[ConformityRule, ...]:
        """The rules of a list such as ``C-03,C-07``; "": all. Raises ScenarioError."""
        if not text:
            return self.rules
        names = [name.strip().upper() for name in text.split(",") if name.strip()]
        for name in names:
            if name not in self._by_number:
                raise ScenarioError(f"--rules: {unknown(name, list(self._by_number), 'rule')}")
        return tuple(rule for rule in self.rules if rule.number in names)

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts that may be left out, sorted."""
        return tuple(sorted({rule.part for rule in self.rules if rule.part}))

    def left_out(self, text: str) -> tuple[str, ...]:
        """The parts of a list such as ``joining,ranges``. Raises ScenarioError."""
        names = tuple(name.strip() for name in text.split(",") if name.strip())
        for name in names:
            if name not in self.parts:
                raise ScenarioError(f"--without: {unknown(name, list(self.parts), 'part')}")
        return names

    def table(self) -> list[list[str]]:
        """Number, title, clause and expectation of each rule, with the names of the columns."""
        head = ["rule", "title", "clause", "expected"]
        return [head, *([r.number, r.title, r.clause, r.expected] for r in self.rules)]


@dataclass(frozen=True, slots=True)
class ConformityReport:
    """All verdicts of a kit. `subject`: the judged program or device, and its buses."""

    subject: str
    judged: Sequence[JudgedRule]
    seconds: float = 0.0

    @property
    def verdict(self) -> Conformity:
        """FAILED if a rule failed, else INCONCLUSIVE if one is, else PASSED.

        INCONCLUSIVE also if no rule applied.
        """
        found = {judged.verdict for judged in self.judged}
        return next((v for v in _WORST if v in found), Conformity.INCONCLUSIVE)

    @property
    def exit_code(self) -> int:
        """0 passed, 1 failed, 3 inconclusive."""
        return EXIT_CODES[self.verdict]

    def count(self, verdict: Conformity) -> int:
        """Rules with this verdict."""
        return sum(judged.verdict is verdict for judged in self.judged)

    def sentence(self) -> str:
        """The verdict, and how many rules have which."""
        parts = [f"{self.count(v)} {v}" for v in Conformity if self.count(v)]
        return f"{self.verdict}: {', '.join(parts) or 'no rule'} in {self.seconds:.1f} s"

    def as_data(self) -> Mapping[str, Any]:
        """The data for ``--json``."""
        return {
            "subject": self.subject,
            "verdict": str(self.verdict),
            "seconds": round(self.seconds, 3),
            "rules": [
                {
                    "rule": j.rule.number,
                    "title": j.rule.title,
                    "clause": j.rule.clause,
                    "expected": j.rule.expected,
                    "verdict": str(j.verdict),
                    "came": j.came,
                    "late_ms": round(j.late_ms, 2),
                    "seconds": round(j.seconds, 3),
                }
                for j in self.judged
            ],
        }
