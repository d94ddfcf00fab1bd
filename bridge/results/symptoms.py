"""Signs of faults in a rehearsal's journals and reports, for
:mod:`bridge.results.detection`.

Times are s since the start of the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.carried import Carried
from bridge.deployment.system import System
from bridge.native.bus import Accept
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.records.node_lives import Life, frame_files, lives_of
from bridge.records.records import Done, LifeEnd, Note, Statement
from bridge.results.extra_senders import extra_frames
from bridge.results.findings import Sign, Signs
from bridge.results.report import NodeReport
from bridge.wiring.wiring import HEARD, Rows

#: Evidence of each kind, of which a report shows at least one: counters of receivers, or signs.
SIGNS: Mapping[str, tuple[str, ...]] = {
    "drop": ("lost",),
    "burst": ("lost",),
    "sync-loss": ("syncs",),
    "corrupt": ("crc", "length", "invalid", "range"),
    "duplicate": ("repeated", "reordered"),
    "reorder": ("reordered",),
    "delay": ("age", "silence"),
    "jitter": ("age", "reordered"),
    "kill": ("ended",),
    "restart": ("life", "refusal"),
    "freeze": ("late", "ended"),
    "noise": ("ended",),
    "clock-jump": ("late", "stopped", "silence"),
    "bus-down": ("health",),
    "forge": (
        *("wrong_sequence", "reordered", "repeated", "range", "rate", "invalid", "resyncs"),
        *("surplus", "altered"),
    ),
    "replay": ("wrong_sequence", "reordered", "repeated", "stale", "surplus", "altered"),
    "absurd": ("range", "rate", "invalid", "altered"),
    "flood": ("wrong_sequence", "reordered", "repeated", "resyncs", "surplus"),
    "babble": ("frames",),
    "drive": ("told", "silence", "still", "waited"),
    "net-down": ("silence", "lost"),
    "net-delay": ("age", "silence"),
    "net-loss": ("lost",),
    "net-rate": ("age", "silence", "lost"),
}
#: Share of what was done that has to show, in numbers and in time.
ENOUGH, LONG = 0.5, 0.8
#: s after the end of a fault within which what it did may show.
AFTER = 3.0
#: s before a fault in which samples show how far the clocks of two nodes differ.
BEFORE = 0.2


@final
@dataclass(frozen=True, slots=True)
class FinishedRun:
    """A finished rehearsal: `rows` and reports by life, `notes`, files of lives in `nodes`;
    `altered`: samples that a life heard otherwise than they were sent, by life and message.
    """

    system: System
    rows: Mapping[Life, Rows]
    reports: Sequence[NodeReport]
    nodes: Path
    notes: Sequence[Note]
    altered: Mapping[tuple[Life, str], int] = field(default_factory=dict)

    def statement(self, life: Life) -> Statement | None:
        """The report of a life; None if it ended before it could write one."""
        return next((r.statement for r in self.reports if r.life == life), None)

    def lives(self, node: str) -> list[Life]:
        """The lives of a node, the first one first."""
        return lives_of(self.rows, node)

    def record(self, life: Life) -> Rows | None:
        """Return the faults (n,) on frames of a life (INJECTED); None without a script."""
        path = self.nodes / life.file("faults")
        return Journal.open(path) if path.is_file() else None

    # ---- counters ----------------------------------------------------------------------------

    def counter_signs(self, life: Life, message: str, names: Sequence[str], done: int) -> Signs:
        """Counters of a receiver, if they are enough for `done` frames."""
        said = self.statement(life)
        counts = said.messages.get(message, {}) if said else {}
        found = {name: counts.get(name, 0) for name in names}
        if sum(found.values()) < max(1.0, ENOUGH * done):
            return ()
        return tuple(Sign(what=name, number=n) for name, n in found.items() if n)

    def extra_frames(self, life: Life, message: str) -> Signs:
        """Number of frames of a message that were received in addition to those sent."""
        found = extra_frames(self.system, self.rows, self.reports)
        more = (s.heard - s.sent for s in found if (s.life, s.message) == (life, message))
        return tuple(Sign(what="surplus", number=n) for n in more)

    def altered_samples(self, life: Life, message: str) -> Signs:
        """Number of samples that were received with other values than were sent."""
        n = self.altered.get((life, message), 0)
        return (Sign(what="altered", number=n),) if n else ()

    def foreign_frames(self, bus: str, accept: Accept) -> int:
        """The most frames of an identifier that a life received on a bus and no life sent there."""
        logs = {life: Journal.open(p) for life, p in frame_files(self.nodes, bus).items()}
        rows = {
            life: log[accept.among(log)]["flags"] & Flags.SENT != 0 for life, log in logs.items()
        }
        sent = {life: int(np.count_nonzero(own)) for life, own in rows.items()}
        return max((len(own) - sum(sent.values()) for own in rows.values()), default=0)

    # ---- times -------------------------------------------------------------------------------

    def age(self, life: Life, message: str, t0: float, t1: float, least: float) -> Signs:
        """The time that a sample of this time was on the way, if that is nearly `least` s.

        Where clocks differ, by how much longer than before. What a gateway hears is seen where it
        arrives that the gateway makes of it.
        """
        worst = 0.0
        for place, name in self._ends(life, message):
            t = self._t(place)
            for i in self._indices(place, name):
                rows = self.rows[place]["inlets"][:, i]
                heard = rows["newest"] >= 0
                taken = rows["transit_ns"] * 1e-9 + self._apart(place, name, rows)
                during = taken[heard & (t >= t0) & (t <= t1 + AFTER)]
                before = taken[heard & (t >= t0 - BEFORE) & (t < t0)]
                if len(during):  # before it they arrive before they are sent: clocks differ
                    ahead = -float(before.max()) if len(before) and before.max() < 0 else 0.0
                    worst = max(worst, float(during.max()) + ahead)
        return (Sign(what="age", number=worst),) if worst >= LONG * least > 0 else ()

    def silence(self, life: Life, message: str, t0: float, t1: float) -> Signs:
        """For how long nothing new came, if that is nearly all of the time.

        Samples that are held up leave such a gap before they come, also where they are seen no more
        because faster ones overtake them, and where clocks differ, so that their age says nothing.
        """
        t, longest = self._t(life), 0.0
        for new in self.new_sample_times(life, message):
            at = np.concatenate([t[:1], new, t[-1:]])
            over = (at[:-1] < t1) & (at[1:] > t0)
            longest = max(longest, float(np.diff(at)[over].max(initial=0.0)))
        return (Sign(what="silence", number=longest),) if longest >= LONG * (t1 - t0) else ()

    def new_sample_times(self, life: Life, message: str) -> Iterator[NDArray[np.float64]]:
        """Times of new samples, s, (n,), for each input; for a gateway the times of reception."""
        t, indices = self._t(life), self._indices(life, message)
        for i in indices:
            newest = self.rows[life]["inlets"]["newest"][:, i]
            yield t[np.flatnonzero(np.diff(newest)) + 1]
        path = self.nodes / life.file(HEARD)
        if not indices and path.is_file():
            rows = Journal.open(path)
            number = self.system.received_by(life.node).index(message)
            yield np.sort(rows["arrival_ns"][rows["message"] == number]) * 1e-9

    def late(self, node: str, t0: float, t1: float) -> Signs:
        """The lateness of a slot of this time, if that is nearly as long."""
        worst = 0.0
        for life in self.lives(node):
            rows = self.rows[life]
            t = self._t(life)
            there = rows[(t >= t0 - 0.2) & (t <= t1 + AFTER)]
            late = (there["woke_ns"] - there["deadline_ns"]).max(initial=0)
            worst = max(worst, float(late) * 1e-9)
        return (Sign(what="late", number=worst),) if worst >= LONG * (t1 - t0) > 0 else ()

    def ended(self, node: str, t0: float, t1: float) -> Signs:
        """True if a life of the node was ended in this time."""
        for life in self.lives(node):
            if t0 - 0.2 <= self._t(life)[-1] <= t1 + AFTER and self._cut_short(life):
                return (Sign(what="ended", life=life),)
        return ()

    def by_image(self, node: str) -> bool:
        """True if an image computed the slots of a node."""
        return any((s := self.statement(life)) and s.firmware for life in self.lives(node))

    def over(self, node: str, t: float) -> bool:
        """True if every life of the node had come to its last slot before `t`, and has reported."""
        lives = self.lives(node)
        return bool(lives) and all(not self._cut_short(x) and self.last(x) < t for x in lives)

    def _cut_short(self, life: Life) -> bool:
        """True if a life was ended from outside: it has no report, or its image has failed."""
        said = self.statement(life)
        return said is None or (bool(said.firmware) and said.end is LifeEnd.FAILED)

    def last(self, life: Life) -> float:
        """The time at which the last slot of a life was due, s."""
        return float(self._t(life)[-1])

    def stopped(self, node: str, t0: float) -> Signs:
        """True if a life of the node stopped itself after this time."""
        for report in self.reports:
            late = report.life.node == node and self._t(report.life)[-1] >= t0
            if late and report.end is LifeEnd.FAULT:
                return (Sign(what="stopped", life=report.life),)
        return ()

    def alive(self, node: str, t0: float, t1: float) -> list[Life]:
        """Lives of a node with slots in this time that have a report."""
        return [
            life
            for life in self.lives(node)
            if self.statement(life) and ((self._t(life) >= t0) & (self._t(life) <= t1)).any()
        ]

    def sends(self, message: str, t: NDArray[np.float64]) -> NDArray[np.bool_]:
        """At which times, (n,), the first sender of a message ran: else it sent previews."""
        ran = np.zeros(len(t), dtype=np.bool_)
        for life in self.lives(self._sender(message).node):
            slots = self._t(life)
            ran |= (t >= slots[0]) & (t <= slots[-1])
        return ran

    def arrives(self, life: Life, message: str, t0: float, t1: float) -> bool:
        """True if its age can be seen, here or where it is forwarded to; all have slots then."""
        if not ((self._t(life) >= t0) & (self._t(life) <= t1)).any():
            return False
        onwards = self._onwards(life, message)
        return bool(self._indices(life, message)) or any(
            self.arrives(other, name, t0, t1) for other, name in onwards
        )

    def lives_throughout(self, node: str, t0: float, t1: float) -> list[Life]:
        """Lives of a node with slots from before this time until after it."""
        return [x for x in self.lives(node) if self._t(x)[0] <= t0 and self._t(x)[-1] >= t1]

    def _sender(self, message: str) -> Carried:
        """The message as its first sender gives it, where gateways forward it."""
        carried = self.system.messages[message]
        while carried.forward is not None:
            carried = self.system.messages[carried.forward.of]
        return carried

    def _apart(self, life: Life, message: str, rows: Rows) -> NDArray[np.float64]:
        """By how much clocks that were set make each newest sample of an inlet look younger, s.

        The samples a sender catches up with when its clock is set forward are sent at once.
        """
        carried = self._sender(message)
        sampled = (rows["newest"] * carried.period_ns + carried.offset_ns) * 1e-9
        arrived = sampled + rows["transit_ns"] * 1e-9
        found = np.zeros(len(rows))
        for note in self._jumps(carried.node):
            passed = sampled - note.t
            found += np.clip(passed, 0.0, note.by) if note.by > 0 else note.by * (passed >= 0)
        for note in self._jumps(life.node):
            found -= note.by * (arrived >= note.t + max(note.by, 0.0))
        return found

    def _jumps(self, node: str) -> list[Done]:
        """The times at which the clock of a node was set."""
        done = (n for n in self.notes if isinstance(n, Done))
        return [n for n in done if (n.action, n.target) == ("clock-jump", node)]

    def _ends(self, life: Life, message: str) -> Iterator[tuple[Life, str]]:
        """Destinations of a message from here: inputs of this life, and forwarded messages."""
        yield life, message
        for other, name in self._onwards(life, message):
            yield from self._ends(other, name)

    def _onwards(self, life: Life, message: str) -> Iterator[tuple[Life, str]]:
        """Receivers of a message that this gateway life forwards, and the forwarded message."""
        for name, made in self.system.messages.items():
            if made.forward is None or (made.forward.of, made.node) != (message, life.node):
                continue
            for node in self.system.nodes:
                if name in self.system.received_by(node):
                    yield from ((other, name) for other in self.lives(node))

    def span(self, life: Life, t0: float, t1: float) -> tuple[float, float]:
        """Two times of a life's own clock, by which frames meet faults, on the clock of the run."""
        low, high = np.interp([t0, t1], self._own(life), self._t(life)).tolist()
        return low, high

    def _own(self, life: Life) -> NDArray[np.float64]:
        h = self.system.nodes[life.node].h
        return np.asarray(self.rows[life]["slot"] * h, dtype=np.float64)

    def _t(self, life: Life) -> NDArray[np.float64]:
        """The times (rows,), s, at which slots were due by the clock of the run, not its own."""
        t = self._own(life)
        for note in self._jumps(life.node):
            if t[0] <= note.t <= t[-1]:
                after = t >= note.t + max(note.by, 0.0)
                t = np.where(after, t - note.by, np.minimum(t, note.t))
        return t

    def _indices(self, life: Life, message: str) -> list[int]:
        inlets = self.system.nodes[life.node].inlets
        return [i for i, inlet in enumerate(inlets) if inlet.message == message]
