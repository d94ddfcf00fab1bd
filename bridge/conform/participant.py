"""The kit for participants: its rules, and how they are judged one after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

from bridge.conform.checks import (
    BrokenRuleError,
    Check,
    CheckScene,
    InapplicableRuleError,
    VoidAttemptError,
)
from bridge.conform.end_checks import END_CHECKS
from bridge.conform.epoch_checks import EPOCH_CHECKS
from bridge.conform.input_checks import INPUT_CHECKS
from bridge.conform.life_checks import LIFE_CHECKS
from bridge.conform.rules import Conformity, ConformityReport, ConformityRule, JudgedRule, RuleBook
from bridge.conform.sent_checks import SENT_CHECKS
from bridge.conform.stage import ParticipantStage, UnreadyError
from bridge.deployment.system import System
from cosim.base.clock import monotonic_ns, stopwatch
from cosim.base.copies import replace
from cosim.base.errors import CosimError, ScenarioError
from cosim.base.names import unknown

#: Parts that a participant may leave out, by rule.
PARTS = {
    "C-16": "epoch-sent",
    "C-33": "estop-sent",
    "C-77": "date",
    "C-78": "date",
    **dict.fromkeys(("C-57", "C-58"), "ranges"),
    **dict.fromkeys(("C-73", "C-74", "C-75"), "joining"),
    **{c.rule.number: "watchdogs" for c in INPUT_CHECKS if c.rule.number not in ("C-57", "C-58")},
}
#: Rules of participants that leave a part out, with this part.
IN_PLACE = {"C-79": "date", "C-80": "date"}
CHECKS = (*SENT_CHECKS, *LIFE_CHECKS, *INPUT_CHECKS, *END_CHECKS, *EPOCH_CHECKS)
PARTICIPANT_RULES = RuleBook(
    replace(check.rule, part=PARTS.get(check.rule.number, ""))
    for check in sorted(CHECKS, key=lambda check: check.rule.number)
)
#: A rule is broken if it is in so many attempts in which the kit was in time, of at most so many.
BROKEN, ATTEMPTS = 2, 5
#: s: lateness with which a verdict of a rule that waits for seconds still counts.
SECONDS = 0.3


@final
class ParticipantKit:
    """Judges the participant `node` of a deployment, which `command` starts (empty: it runs).

    `without`: parts that it leaves out; their rules do not apply.
    """

    def __init__(
        self, system: System, node: str, command: Sequence[str], without: Sequence[str] = ()
    ) -> None:
        self._without = without
        self._stage = ParticipantStage(system, node, command)

    def judge(
        self,
        rules: Sequence[ConformityRule],
        say: Callable[[JudgedRule], None] = lambda judged: None,
    ) -> ConformityReport:
        """The verdicts of some rules; `say` gets each as it is found. Raises CosimError."""
        elapsed, found = stopwatch(), dict[str, JudgedRule]()
        wanted = {rule.number for rule in rules}
        checks = [check for check in CHECKS if check.rule.number in wanted]
        with self._stage.open():
            for check in sorted(checks, key=lambda c: (c.scene, c.rule.number)):
                if check.scene is CheckScene.RECORD and not self._stage.runs:
                    self._show()
                found[check.rule.number] = self._judged(check)
                say(found[check.rule.number])
        judged = [found[rule.number] for rule in rules]
        return ConformityReport(self._subject(), judged, elapsed())

    def _subject(self) -> str:
        s = self._stage
        buses = (f"{b} ({s.system.deployment.buses[b].kind})" for b in s.buses)
        return f"{s.node} of {s.system.deployment.path} on {', '.join(buses)}"

    def _show(self) -> None:
        """Let the participant run for a while: for rules about what it sends, asked for alone."""
        from cosim.base.clock import sleep

        try:
            self._stage.make_waiting()
            self._stage.make_active()
        except UnreadyError:
            return
        sleep(1.0)

    def _prepare(self, check: Check) -> None:
        if check.scene is CheckScene.WAITING:
            self._stage.make_waiting()
        elif check.scene in (CheckScene.ACTIVE, CheckScene.ENDING):
            self._stage.make_active(check.needs)

    def _bears(self, check: Check) -> float:
        """The lateness with which a broken rule counts, s."""
        seconds = check.scene is CheckScene.OTHER_LIFE  # these rules wait for seconds
        return max(self._stage.bears, SECONDS if seconds else 0.0)

    def _judged(self, check: Check) -> JudgedRule:
        elapsed, stage = stopwatch(), self._stage
        broken, came, late = 0, "", 0.0

        def verdict(found: Conformity) -> JudgedRule:
            return JudgedRule(check.rule, found, came, late * 1e3, elapsed())

        if PARTS.get(check.rule.number) in self._without:
            came = f"left out: {PARTS[check.rule.number]}"
            return verdict(Conformity.NOT_APPLICABLE)

        if (part := IN_PLACE.get(check.rule.number)) and part not in self._without:
            came = f"of participants without a part that this one has: {part}"
            return verdict(Conformity.NOT_APPLICABLE)

        for _ in range(ATTEMPTS if check.scene is not CheckScene.RECORD else 1):
            since = monotonic_ns()
            try:
                self._prepare(check)
                since = monotonic_ns()
                came = check.judge(stage)
                if stage.cast.fault:
                    raise CosimError(f"the kit could not play its roles: {stage.cast.fault}")
                return verdict(Conformity.PASSED)
            except InapplicableRuleError as error:
                came = str(error)
                return verdict(Conformity.NOT_APPLICABLE)
            except (VoidAttemptError, UnreadyError) as error:
                came = came or str(error)
                if stage.dead:
                    break
            except BrokenRuleError as error:
                came = str(error)
                late = stage.lateness.worst_ns(since) * 1e-9
                broken += check.scene is CheckScene.RECORD or late <= self._bears(check)
                if broken >= (1 if check.scene is CheckScene.RECORD else BROKEN):
                    return verdict(Conformity.FAILED)
        mute = not stage.program.running or stage.lateness.worst_ns(0) * 1e-9 <= stage.bears
        failed = stage.dead and mute and check.rule.number == "C-10"
        return verdict(Conformity.FAILED if failed else Conformity.INCONCLUSIVE)


def check_judgeable(system: System, node: str) -> None:
    """Raise ScenarioError for a node that the kit cannot judge, and for a deployment without a
    wall clock.
    """
    d = system.deployment
    if node not in system.nodes:
        raise ScenarioError(unknown(node, list(system.nodes), "node"), str(d.path))
    lockstep = [n for n, b in d.buses.items() if b.options.get("lockstep")]
    if d.clock != "wall" or lockstep:
        raise ScenarioError('found no wall clock; expected clock = "wall"', str(d.path))
    drives = [name for name, m in d.messages.items() if m.profile and _is_of(system, node, name)]
    if drives:
        raise ScenarioError(
            f"{node} talks to drives with their own protocols ({drives[0]}); expected a node whose "
            "messages are all of this project",
            d.place("messages", drives[0]),
        )
    if not d.nodes[node].components:
        raise ScenarioError(f"{node} is a gateway; expected a node with components", str(d.path))


def _is_of(system: System, node: str, message: str) -> bool:
    return system.messages[message].node == node or message in system.received_by(node)
