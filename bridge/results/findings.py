"""Evidence of faults in a report: typed records, and their sentences for readers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

from bridge.records.node_lives import Life
from bridge.records.records import Note, Record


class Sign(Record, frozen=True, kw_only=True):
    """A sign of a fault: what (:data:`bridge.results.symptoms.SIGNS`), how many or how long (s),
    whose; of a drive, what it `said`.
    """

    what: str
    number: float = 0.0
    life: Life | None = None
    note: Note | None = None
    said: str = ""

    def __str__(self) -> str:
        """For people: ``41 lost``, ``0.48 s late``."""
        n = self.number
        match self.what:
            case "age":
                return f"up to {n * 1e3:.0f} ms on the way"
            case "silence":
                return f"nothing for {n:.2f} s"
            case "late":
                return f"{n:.2f} s late"
            case "ended":
                return f"{self.life} has ended"
            case "stopped":
                return f"{self.life} has stopped"
            case "told":
                return f"{self.life} was told {self.said} at {n:.3f} s"
            case "waited":
                return f"it was enabled {n:.2f} s after its bring-up began"
            case "still":
                return f"its position stood still for {n:.2f} s"
            case "life":
                return f"{self.life} began"
            case "health":
                return f"{self.life}: the bus was not well"
            case "frames":
                return f"{n:.0f} frames that no node has sent"
            case "surplus":
                return f"{n:.0f} more frames than were sent"
            case "altered":
                return f"{n:.0f} samples that are not those sent"
            case "syncs":
                return f"{n:.0f} SYNC lost"
            case "refusal" if self.note is not None:
                return self.note.describe()
        return f"{n:.0f} {self.what.replace('_', ' ')}"


Signs: TypeAlias = tuple[Sign, ...]


class Place(Record, frozen=True, kw_only=True):
    """A place where a fault did something `done` times: a life and a message, a node or a bus."""

    target: str
    message: str = ""
    done: int = 0
    signs: Signs = ()

    def __str__(self) -> str:
        """Its name for people: ``master xi_slave``."""
        return f"{self.target} {self.message}".rstrip()


class Evidence(Record, frozen=True, kw_only=True):
    """One table of a script, from `t0` to `t1` (s): where it acted, and what the report shows."""

    index: int
    kind: str
    targets: Sequence[str]
    messages: Sequence[str | int] = ()
    t0: float
    t1: float
    places: Sequence[Place]

    @property
    def done(self) -> int:
        """The number of times that it did something."""
        return sum(p.done for p in self.places)

    @property
    def missing(self) -> tuple[Place, ...]:
        """Places where it did something that nothing shows."""
        return tuple(p for p in self.places if p.done and not p.signs)

    @property
    def verdict(self) -> Literal["seen", "unseen", "idle"]:
        """Seen, unseen, or idle: it had nothing to act on."""
        if self.missing:
            return "unseen"
        return "seen" if self.done else "idle"

    @property
    def shown(self) -> tuple[str, ...]:
        """The signs, in words."""
        return tuple(
            f"{p}: {', '.join(map(str, p.signs))}" for p in self.places if p.done and p.signs
        )

    def text(self) -> str:
        """One line of a report."""
        when = f"{self.t0:.2f} s" + (f" to {self.t1:.2f} s" if self.t1 > self.t0 else "")
        missing = [f"{p}: NOT SEEN" for p in self.missing]
        said = "; ".join(dict.fromkeys((*self.shown, *missing))) or "nothing to act on"
        where = f"on {', '.join(self.targets)}"
        if self.messages:
            named = [m if isinstance(m, str) else f"{m:#x}" for m in self.messages]
            where = f"of {', '.join(named)} at {', '.join(self.targets)}"
        return f"{self.kind} {where}, {when}, {self.done} x: {said}"

    def facts(self) -> dict[str, Any]:
        """For ``run.json``."""
        return {**super().facts(), "done": self.done, "verdict": self.verdict}
