"""The verdict of a rehearsal: passed, failed or inconclusive, with reasons.

*Failed*: a node stopped before the end, also where it was started again, the replay differs from
the run, more or other samples were received than sent, values were out of range, an injected fault
is not in the report, a drive told old positions that no node noticed, a real drive was off or
did not answer its torques (:mod:`bridge.results.drive_answers`), or, in a run that would have
passed otherwise, a requirement of the scenario is not met.
*Inconclusive*: a simulated bus was so far behind the wall clock that a node would have to stop;
or a slow machine or bus can explain all problems (of a real drive: that it told
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
from bridge.native.safety import LifeState, Why
from bridge.records.records import LifeEnd, reason_names, reason_text
from bridge.results import overload
from bridge.results.detection_drives import told_words
from bridge.results.drive_answers import silent_ends
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
#: Further reasons that another motion than that of the deployment causes.
OF_MOTION = frozenset({"guard", "component"})
#: Share of the slots of a node that it may miss: beyond it the period is not the configured one.
MISSED = 0.1


@dataclass(frozen=True, slots=True)
class Verdict:
    """A word and its reasons; none: passed."""

    word: Word
    reasons: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """The exit code of a command with this verdict."""
        return EXIT[self.word]

    def text(self, well: str = "") -> str:
        """``failed: slave (overrun)``; `well`: what is said where it passed."""
        said = "; ".join(self.reasons) or well
        return f"{self.word}: {said}" if said else str(self.word)


def judge(system: System, outcome: RehearsalOutcome) -> Verdict:
    """Evaluate a finished run by its journals and reports."""
    timed = [
        *_timing_reasons(outcome),
        *_old_torques(system, outcome),
        *silent_ends(system, outcome.rows, outcome.reports),
    ]
    found, off = list(_always(system, outcome)), outcome.unanswered
    moved, drives = list(_of_motion(outcome)), list(_detected_drives(outcome))
    if (lag := overload.lagging(system, outcome)) and not (found or off):
        return Verdict(Word.INCONCLUSIVE, (lag, *moved, *timed, *drives))
    found += moved
    if timed and off and not found:  # a machine that stands still starves drives, too
        verdict = of_time(system, outcome, timed)
        return Verdict(verdict.word, (*verdict.reasons, *off, *drives))
    if found or off:
        return Verdict(Word.FAILED, (*found, *off, *timed, *drives))
    if timed:
        return of_time(system, outcome, [*timed, *drives])
    missed = tuple(_missed_slots(system, outcome))
    if missed:
        return Verdict(Word.INCONCLUSIVE, missed)
    violated = tuple(_violated(outcome))
    return Verdict(Word.FAILED if violated else Word.PASSED, violated)


def _violated(outcome: RehearsalOutcome) -> Iterator[str]:
    """Requirements of the scenario that the run does not meet."""
    for result in outcome.required:
        if result.verdict == "failed":
            yield f"requirement {result.line}"


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
    """True if a life of a node ended otherwise than it should."""
    return not outcome.finished and report.end is not LifeEnd.FINISHED


def _of_time(report: NodeReport) -> bool:
    """True if a node stopped for a reason that lateness explains: also drives that told nothing."""
    events = report.statement.drives if report.statement else ()
    lost = {str(event["failure"]) for event in events if event["failure"]}
    return bool(set(report.reasons) & OF_TIME) or (
        "drive" in report.reasons and lost == {Failure.SILENT.name.lower()}
    )


def _stopped_before(outcome: RehearsalOutcome) -> Iterator[tuple[str, bool]]:
    """Stops after which a life was started again, and whether lateness can cause them."""
    for report in outcome.reports:
        rows = outcome.rows[report.life]
        if _stopped_early(outcome, report) or not len(rows["slot"]):
            continue  # it is the end of the life
        stopped = np.isin(rows["state"], (LifeState.STOPPING, LifeState.FAULT))
        bits = rows["reasons"] & np.uint32(~Why.COMMAND & 0xFFFFFFFF)
        at = np.flatnonzero(stopped & (bits != 0))
        if not len(at):
            continue
        names = reason_names(int(np.bitwise_or.reduce(bits[at])))
        t = float(rows["deadline_ns"][at[0]]) * 1e-9
        why = reason_text(names, list(dict.fromkeys(_lost(report))))
        yield f"{report.life} was stopped at t = {t:.3f} s: {why}", set(names) <= OF_TIME


def _lost(report: NodeReport) -> Iterator[str]:
    """A sentence for each time that a life gave a drive up."""
    for change in report.statement.drives if report.statement else ():
        if change["phase"] == "failed":
            yield f"{change['drive']} told {told_words(change)} at {change['t']:.3f} s"


def _always(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that neither lateness nor another motion can explain."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and not (_of_time(report) or _moved(report)):
            yield _ended(report)
    yield from (text for text, timed in _stopped_before(outcome) if not timed)
    if outcome.replayed is None:
        yield f"cannot be replayed: {outcome.replay_error}"
    elif outcome.replayed.first is not None:
        yield f"the replay is not the run: {outcome.replayed.first}"
    if outcome.replayed is not None:
        yield from (str(a) for a in outcome.replayed.altered if a.misnumbered < a.count)
    yield from map(str, extra_frames(system, outcome.rows, outcome.reports))
    yield from extra_services(system, outcome.reports)
    for fault in outcome.faults:
        for place in fault.places:
            if place.signs and {sign.what for sign in place.signs} <= {"still"}:
                yield f"{place}: {place.signs[0]} while its joint moved, and no node noticed"


def _of_motion(outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that a motion causes that is not the deployment's, as on a bus that is late."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and not _of_time(report) and _moved(report):
            yield _ended(report)
        for message, counts in (report.statement.messages if report.statement else {}).items():
            if counts.get("range"):
                yield f"{report.life}: {message}: {counts['range']} samples out of range"


def _moved(report: NodeReport) -> bool:
    """True if a node stopped for a reason that another motion explains."""
    return bool(report.reasons) and set(report.reasons) <= OF_MOTION | OF_TIME


def _ended(report: NodeReport) -> str:
    said = report.statement.error if report.statement else ""
    return f"{report.life}: {report.why or said or report.end}"


def _timing_reasons(outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that a stalled machine can cause as well."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and _of_time(report):
            yield f"{report.life}: {report.why}"
    yield from (text for text, timed in _stopped_before(outcome) if timed)
    if outcome.replayed is not None:  # too late for their counter
        yield from (str(a) for a in outcome.replayed.altered if a.misnumbered == a.count)
    for fault in outcome.faults:
        if fault.missing:
            yield f"not in the report: {fault.text()}"


def _detected_drives(outcome: RehearsalOutcome) -> Iterator[str]:
    """Injected faults of drives that the report shows: what a run with problems is due to."""
    for fault in outcome.faults:
        if fault.kind == "drive" and fault.verdict == "seen":
            yield f"injected and noticed: {fault.text()}"


def _old_torques(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Torques that drives have refused because of their age."""
    for report in outcome.reports:
        node, spec = system.nodes[report.life.node], system.deployment.nodes[report.life.node]
        for message, counts in (report.statement.messages if report.statement else {}).items():
            if counts.get("stale") and drives_by(node, spec, message):
                text = f"{report.life} refused {counts['stale']} torques of {message}"
                yield f"{text}, which were older than its drive allows"
