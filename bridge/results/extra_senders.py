"""Unknown senders: messages and services of which a node received more frames than were sent.

So a flood of valid frames shows, a recording that is played again, and a second sender, whatever
is in their frames.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bridge.deployment.carried import Carried
from bridge.deployment.system import System
from bridge.records.node_lives import Life, lives_of
from bridge.records.records import Statement
from bridge.results.report import NodeReport
from bridge.wiring.wiring import Rows

#: Counters of a receiver that are each of another frame. Repeated ones are left out: a network may
#: duplicate, and they are never accepted.
FRAMES = (
    "ok",
    "reordered",
    "wrong_sequence",
    "crc",
    "length",
    "invalid",
    "range",
    "rate",
    "simulated",
)
#: Part of what was sent, and frames, that may be heard beyond it: duplicated, then overtaken.
BEYOND, FEW = 0.02, 5


@dataclass(frozen=True, slots=True)
class Surplus:
    """A message of which a life received more samples than were sent."""

    life: Life
    message: str
    heard: int
    sent: int

    def __str__(self) -> str:
        return (
            f"{self.life} heard {self.heard} frames of {self.message}, of which {self.sent} were "
            "sent: somebody else sends it, too"
        )


def extra_frames(
    system: System, rows: Mapping[Life, Rows], reports: Sequence[NodeReport]
) -> Iterator[Surplus]:
    """Yield messages with more received than sent frames: a flood, a replay or a second sender.

    `rows`: the rows (slots,) of each life. What a node sends that did not run here, such as a real
    drive, is not known.
    """
    here = {report.life.node for report in reports}
    for report in reports:
        for message, counts in (report.statement.messages if report.statement else {}).items():
            if system.messages[message].node not in here:
                continue
            heard = sum(counts.get(name, 0) for name in FRAMES)
            sent = _sent(system, rows, reports, system.messages[message])
            if heard > sent * (1 + BEYOND) + FEW:
                yield Surplus(report.life, message, heard, sent)


def extra_services(system: System, reports: Sequence[NodeReport]) -> Iterator[str]:
    """Sentences about services that nobody in this run has sent: heartbeats, EPOCHs, STARTs while a
    node ran, and messages longer than any can be.

    What a node that was killed has sent is not known.
    """
    said = [(report.life, report.statement) for report in reports if report.statement]
    whole = len(said) == len(reports)
    for life, own in said:
        for peer, heard in own.heartbeats.items():
            theirs = [r.statement for r in reports if r.life.node == peer]
            if theirs and all(theirs):
                buses, what = len(system.buses_of(peer)), f"heartbeats of {peer}"
                known = [s for s in theirs if s]
                yield from _surplus(life, heard, "heartbeats_sent", what, known, buses)
        others = [statement for other, statement in said if other != life]
        epochs = own.services.get("epochs", 0)
        if whole:
            buses = len(system.buses_of(life.node))
            yield from _surplus(life, epochs, "epochs_sent", "EPOCHs", others, buses)
        late = own.services.get("late_starts", 0)
        if late > FEW:
            yield f"{life} heard {late} STARTs while it ran: another sender starts a running run"
        for bus, health in own.buses.items():
            if health.get("oversized"):
                count = health["oversized"]
                yield f"{life} heard {count} messages longer than any of this deployment on {bus}"


def _surplus(
    life: Life, heard: int, key: str, what: str, senders: Sequence[Statement], buses: int
) -> Iterator[str]:
    """A sentence where more was heard than these senders sent, once on each of so many buses."""
    sent = sum(statement.services.get(key, 0) for statement in senders)
    if heard > sent * buses * (1 + BEYOND) + FEW:
        yield (
            f"{life} heard {heard} {what}, of which {sent} were sent: somebody else sends them, too"
        )


def _sent(
    system: System,
    rows: Mapping[Life, Rows],
    reports: Sequence[NodeReport],
    carried: Carried,
) -> int:
    """Frames of a message that its sender has sent; of a killed one: had to send in its slots.

    A gateway that was killed does not say what it forwarded: then as many as there were to forward.
    """
    if carried.forward is not None:
        of_gateway = [r for r in reports if r.life.node == carried.node]
        said = [r.statement.forwards.get(carried.name, {}) for r in of_gateway if r.statement]
        if said and len(said) == len(of_gateway):
            return sum(int(facts.get("sent", 0)) for facts in said)
        return _sent(system, rows, reports, system.messages[carried.forward.of])
    ticks = system.nodes[carried.node].ticks
    total = 0
    for life in lives_of(rows, carried.node):
        statement = next((r.statement for r in reports if r.life == life), None)
        if statement and carried.name in statement.sent:
            total += statement.sent[carried.name].get("frames", 0)
        else:
            due = rows[life]["slot"] * ticks % carried.outlet.ticks == 0
            total += int(np.count_nonzero(due))
    return total
