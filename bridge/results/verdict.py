"""The verdict of a rehearsal: passed, failed or inconclusive, with reasons.

*Failed*: a node stopped before the end, the replay differs from the run, more or other samples were
received than sent, values were out of range, or an injected fault is not in the report.
*Inconclusive*: a slow machine can explain all problems, and a node was so late that it would cause
them, although no fault made it late; or there is no problem, but a node missed so many slots that
this was another controller than the configured one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.protection import drives_by
from bridge.deployment.system import System
from bridge.records.records import LifeEnd
from bridge.results.extra_senders import extra_frames
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
#: Faults that make a node late on purpose, and s for which that may last beyond them.
LATE_FAULTS, AFTER = ("freeze", "clock-jump", "restart", "kill"), 1.0
#: s; where a deployment has no time limit of its own.
LIMIT = 0.1
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
    found = list(_always(system, outcome))
    if found:
        return Verdict(Word.FAILED, (*found, *timed))
    late = unplanned_lateness(system, outcome)
    if timed and late >= limit(system) / 2:
        why = f"this machine let a node wait for {late * 1e3:.0f} ms"
        return Verdict(Word.INCONCLUSIVE, (why, *timed))
    if timed:
        return Verdict(Word.FAILED, tuple(timed))
    missed = tuple(_missed_slots(system, outcome))
    return Verdict(Word.INCONCLUSIVE if missed else Word.PASSED, missed)


def _missed_slots(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Lives that missed too many slots without a fault that makes them late."""
    for report in outcome.reports:
        late = _late(outcome, report)
        share = float(np.mean(late >= system.nodes[report.life.node].plan.h * 1e9))
        if share > MISSED:
            why = "the machine is too slow for its period"
            yield f"{report.life} missed {share:.0%} of its slots: {why}"


def _stopped_early(outcome: RehearsalOutcome, report: NodeReport) -> bool:
    """Whether a life of a node ended otherwise than it should."""
    return not outcome.finished and report.end is not LifeEnd.FINISHED


def _always(system: System, outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that lateness cannot explain."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and not set(report.reasons) & OF_TIME:
            yield f"{report.life}: {report.why or report.end}"
    if outcome.replayed is None:
        yield f"cannot be replayed: {outcome.replay_error}"
    elif outcome.replayed.first is not None:
        yield f"the replay is not the run: {outcome.replayed.first}"
    if outcome.replayed is not None:
        yield from map(str, outcome.replayed.altered)
    for report in outcome.reports:
        for message, counts in (report.statement.messages if report.statement else {}).items():
            if counts.get("range"):
                yield f"{report.life}: {message}: {counts['range']} samples out of range"
    yield from map(str, extra_frames(system, outcome.rows, outcome.reports))


def _timing_reasons(outcome: RehearsalOutcome) -> Iterator[str]:
    """Reasons that a stalled machine can cause as well."""
    for report in outcome.reports:
        if _stopped_early(outcome, report) and set(report.reasons) & OF_TIME:
            yield f"{report.life}: {report.why}"
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


# ---- how late -------------------------------------------------------------------------------


def limit(system: System) -> float:
    """The shortest lateness that stops a node of the deployment, s."""
    d = system.deployment
    found = [
        d.seconds(spec.overrun, "nodes", name, "overrun")
        for name, spec in d.nodes.items()
        if spec.components
    ]
    return min((x for x in found if x > 0), default=LIMIT)


def unplanned_lateness(system: System, outcome: RehearsalOutcome) -> float:
    """The greatest lateness of a slot without a fault that is meant to cause it, s."""
    late = (_late(outcome, report).max(initial=0) for report in outcome.reports)
    return max(map(float, late), default=0.0) * 1e-9


def _late(outcome: RehearsalOutcome, report: NodeReport) -> NDArray[np.int64]:
    """Lateness (slots,) of a life, ns; 0 where a fault is meant to cause it."""
    rows = outcome.rows[report.life]
    t = rows["deadline_ns"] * 1e-9
    meant = np.zeros(len(rows), bool)
    for fault in outcome.faults:
        if fault.kind in LATE_FAULTS and report.life.node in fault.targets:
            meant |= (t >= fault.t0 - AFTER) & (t <= fault.t1 + AFTER)
    return np.where(meant, 0, rows["woke_ns"] - rows["deadline_ns"])
