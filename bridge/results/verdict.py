"""The verdict of a rehearsal: passed, failed or inconclusive, with reasons.

*Failed*: a node stopped before the end, the replay differs from the run, more or other samples were
received than sent, values were out of range, an injected fault is not in the report, or a real
drive was off or did not answer its torques (:mod:`bridge.results.drive_answers`).
*Inconclusive*: a slow machine or bus can explain all problems (of a real drive: that it told
nothing, or did not answer while a node stopped), and was so late that it would cause them, although
no fault made it late (:mod:`bridge.results.overload`); or there is no problem, but a node missed so
many slots that this was another controller than the configured one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from bridge.deployment.protection import drives_by
from bridge.deployment.system import System
from bridge.native.commanded import Failure
from bridge.records.records import LifeEnd
from bridge.results import overload
from bridge.results.extra_senders import extra_frames, extra_services
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.report import NodeReport


class Word(StrEnum):
    """The verdicts there are; `ERROR`: there is nothing to judge."""

    PASSED = "passed"
    FAILED = "failed"
    INCONCLUSIVE = "inconclusive"
    ERROR = "error"


#: Exit statuses of commands.
EXIT: Mapping[Word, int] = {Word.PASSED: 0, Word.FAILED: 1, Word.ERROR: 2, Word.INCONCLUSIVE: 3}
#: Why a node stops where it, or one that it hears, was late.
OF_TIME = frozenset({"overrun", "stale", "peer", "watchdog", "sync", "jump"})
#: Share of the slots of a node that it may miss: beyond it the period is not the configured one.
MISSED = 0.1


@dataclass(frozen=True, slots=True)
class Verdict:
    """A word and its reasons; none: passed."""

    word: Word
    reasons: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """Of a command."""
        return EXIT[self.word]

    def text(self, well: str = "") -> str:
        """``failed: slave (overrun)``; `well`: what is said where it passed."""
        said = "; ".join(self.reasons) or well
        return f"{self.word}: {said}" if said else str(self.word)


def judge(system: System, outcome: RehearsalOutcome) -> Verdict:
    """Evaluate a finished run by its journals and reports."""
    timed = [*_timing_reasons(outcome), *_old_torques(system, outcome)]
    found, off = list(_always(system, outcome)), outcome.unanswered
    if timed and off and not found:  # a machine that stands still starves drives, too
        verdict = of_time(system, outcome, timed)
        return Verdict(verdict.word, (*verdict.reasons, *off))
    if found or off:
        return Verdict(Word.FAILED, (*found, *off, *timed))
    if timed:
        return of_time(system, outcome, timed)
    missed = tuple(_missed_slots(system, outcome))
    return Verdict(Word.INCONCLUSIVE if missed else Word.PASSED, missed)


def of_time(system: System, outcome: RehearsalOutcome, timed: Sequence[str]) -> Verdict:
    """The verdict on problems of time: failed, or inconclusive where machine or bus were late."""
    why = overload.cause(system, outcome)
    return Verdict(Word.INCONCLUSIVE, (why, *timed)) if why else Verdict(Word.FAILED, tuple(timed))


def _missed_slots(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Lives that missed too many slots without a fault that makes them late."""
    for report in outcome.reports:
        share = float(np.mean(overload.missed_slots(system, outcome, report)))
        if share > MISSED:
            why = "the machine is too slow for its period"
            yield f"{report.life} missed {share:.0%} of its slots: {why}"


def _stopped_early(outcome: RehearsalOutcome, report: NodeReport) -> bool:
    """Whether a life of a node ended otherwise than it should."""
    return not outcome.finished and report.end is not LifeEnd.FINISHED


def _of_time(report: NodeReport) -> bool:
    """Whether a node stopped for a reason that lateness explains: also drives that told nothing."""
    events = report.statement.drives if report.statement else ()
    lost = {str(event["failure"]) for event in events if event["failure"]}
    return bool(set(report.reasons) & OF_TIME) or (
        "drive" in report.reasons and lost == {Failure.SILENT.name.lower()}
    )


def _always(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that lateness cannot explain."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and not _of_time(report):
            said = report.statement.error if report.statement else ""
            yield f"{report.life}: {report.why or said or report.end}"
    if outcome.replayed is None:
        yield f"cannot be replayed: {outcome.replay_error}"
    elif outcome.replayed.first is not None:
        yield f"the replay is not the run: {outcome.replayed.first}"
    if outcome.replayed is not None:
        yield from (str(a) for a in outcome.replayed.altered if a.misnumbered < a.count)
    for report in outcome.reports:
        for message, counts in (report.statement.messages if report.statement else {}).items():
            if counts.get("range"):
                yield f"{report.life}: {message}: {counts['range']} samples out of range"
    yield from map(str, extra_frames(system, outcome.rows, outcome.reports))
    yield from extra_services(system, outcome.reports)


def _timing_reasons(outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that a stalled machine can cause as well."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and _of_time(report):
            yield f"{report.life}: {report.why}"
    if outcome.replayed is not None:  # too late for their counter
        yield from (str(a) for a in outcome.replayed.altered if a.misnumbered == a.count)
    for fault in outcome.faults:
        if fault.missing:
            yield f"not in the report: {fault.text()}"


def _old_torques(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Torques that drives have refused because of their age."""
    for report in outcome.reports:
        node, spec = system.nodes[report.life.node], system.deployment.nodes[report.life.node]
        for message, counts in (report.statement.messages if report.statement else {}).items():
            if counts.get("stale") and drives_by(node, spec, message):
                text = f"{report.life} refused {counts['stale']} torques of {message}"
                yield f"{text}, which were older than its drive allows"
