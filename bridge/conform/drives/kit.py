"""The rules of a protocol, judged on one drive."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import final

from bridge.conform.drives.bench import DriveBench, DriveSilentError
from bridge.conform.rules import Conformity, ConformityReport, ConformityRule, JudgedRule, RuleBook

#: Kit and machine may be so late, ns, and a verdict about times still counts.
LATE_NS = 10_000_000
_MOVES = "it needs --may-move"

#: The observation in words, and the verdict: True kept, False broken, None not applicable.
Outcome = tuple[bool | None, str]


@dataclass(frozen=True, slots=True)
class DriveRule:
    """A rule and its check. `moves`: the check changes the state of the drive.

    `timed`: the verdict depends on times, and is none if the kit was late.
    """

    rule: ConformityRule
    check: Callable[[DriveBench], Outcome]
    moves: bool = False
    timed: bool = False


@dataclass(frozen=True, slots=True)
class DriveProtocol:
    """A vendor's protocol: the rules, and the frames that leave the drive without power.

    `prepare` is called before each rule that moves: the drive is disabled then, without an error.
    """

    name: str
    rules: tuple[DriveRule, ...]
    disable: Callable[[DriveBench], None]
    prepare: Callable[[DriveBench], None]

    @property
    def book(self) -> RuleBook:
        """The rules by number."""
        return RuleBook(rule.rule for rule in self.rules)


def numbered(
    letter: str,
    clause: str,
    rows: Iterable[tuple[str, str, str, Callable[[DriveBench], Outcome], str]],
) -> tuple[DriveRule, ...]:
    """Rules from title, section of the vendor's document, expectation, check, and ``moves``,
    ``timed`` or both; `clause`: the document.
    """
    return tuple(
        DriveRule(
            ConformityRule(f"{letter}-{n:02d}", title, f"{clause}, {section}", expected),
            check,
            "moves" in marks,
            "timed" in marks,
        )
        for n, (title, section, expected, check, marks) in enumerate(rows, 1)
    )


@final
class DriveKit:
    """Judges a drive. `may_move`: rules that enable it are judged, too; the user stands clear."""

    def __init__(self, protocol: DriveProtocol, bench: DriveBench, *, may_move: bool) -> None:
        self.protocol, self.bench, self.may_move = protocol, bench, may_move

    def judge(
        self, rules: Sequence[ConformityRule], say: Callable[[JudgedRule], None]
    ) -> ConformityReport:
        """The verdict of each of `rules`, in their order; `say` is called with each.

        A drive that was allowed to move is disabled at the end, whatever happens. Raises BusError
        if the bus cannot be used.
        """
        begin, judged = self.bench.line.now(), []
        numbers = {rule.number for rule in rules}
        try:
            for one in (r for r in self.protocol.rules if r.rule.number in numbers):
                judged.append(self._judged(one))
                say(judged[-1])
        finally:
            if self.may_move:
                self.protocol.disable(self.bench)
        seconds = (self.bench.line.now() - begin) * 1e-9
        subject = f"{self.protocol.name} drive {self.bench.node}"
        return ConformityReport(subject, judged, seconds)

    def _judged(self, one: DriveRule) -> JudgedRule:
        line, begin = self.bench.line, self.bench.line.now()
        if one.moves and not self.may_move:
            return JudgedRule(one.rule, Conformity.NOT_APPLICABLE, _MOVES)
        self.bench.drain()
        line.late_ns = 0
        try:
            if one.moves:
                self.protocol.prepare(self.bench)
            kept, came = one.check(self.bench)
        except DriveSilentError as error:
            seconds = (line.now() - begin) * 1e-9
            return JudgedRule(one.rule, Conformity.INCONCLUSIVE, str(error), 0.0, seconds)
        late = line.late_ns
        verdict = Conformity.NOT_APPLICABLE if kept is None else Conformity.PASSED
        if kept is False:
            verdict = Conformity.FAILED
            if one.timed and late > LATE_NS:
                verdict = Conformity.INCONCLUSIVE
        seconds = (line.now() - begin) * 1e-9
        return JudgedRule(one.rule, verdict, came, late * 1e-6, seconds)
