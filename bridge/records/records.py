"""Reports of nodes and of their supervisor: typed records, written as JSON and read back.

Decisions read fields. The method ``text()`` makes messages for people from these fields; no code
parses them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any, Self, TypeAlias

import msgspec

from bridge.faults.script import Action, FaultEvent
from bridge.native.safety import Why
from bridge.records.node_lives import Life
from bridge.safety.limits import explain, names
from cosim.base.files import write_file

Counts: TypeAlias = Mapping[str, int]


class LifeEnd(StrEnum):
    """The end of a life of a node."""

    FINISHED = "finished"
    STOPPED = "stopped"
    NEVER_STARTED = "never started"
    FAULT = "fault"
    FAILED = "failed"
    TOO_LATE = "too late"
    """It was ready when the run was over."""
    DEAF = "deaf"
    """It came to the end, but had not received a message that it needs, at all or for seconds."""
    ENDED = "ended"
    """An FMU of it ended the simulation."""
    KILLED = "killed"
    """It left no report."""


class Record(msgspec.Struct, frozen=True, kw_only=True):
    """Something that is written as JSON."""

    def facts(self) -> dict[str, Any]:
        """The record as plain data, for JSON."""
        found: dict[str, Any] = msgspec.to_builtins(self)
        return found

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Self:
        """The record of plain data, as :meth:`facts` gives it; other keys are ignored."""
        return msgspec.convert(facts, cls)


class Statement(Record, frozen=True, kw_only=True):
    """The report of a life at its end: the file ``LIFE.json``.

    `reasons`: names of the latched bits of ``Why``; `refused`: why ARM or START was refused last.
    `run`: the number of the run by EPOCH, 0: started without; `clock`: of the host; `unshared`:
    EPOCHs of hosts without a common clock.

    `drives`: changes of the drives that it commands, with `t` s, `drive`, `phase`, `told`, and
    `failure`; `lost_drives`: a sentence for each that stopped the node.

    `messages`: counters of each message's receiver; `sent`: of each outlet. `services`: frames of
    services: ``epochs``, ``late_starts`` (while it ran) and ``damaged`` (not readable) that it
    heard, ``epochs_sent``, ``heartbeats_sent``; `heartbeats`: that it heard, by node. `firmware`:
    ``image``, ``sha256`` and ``machine`` of the image that computed its slots. Times are ns of the
    monotonic clock.
    """

    life: Life
    boots: int = 0
    end: LifeEnd
    error: str = ""
    state: str = ""
    reasons: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    first_slot: int = 0
    slots: int = 0
    missed: int = 0
    start_ns: int = 0
    run: int = 0
    clock: str = ""
    unshared: int = 0
    granted: Mapping[str, Any] = {}
    warning: str = ""
    syncs: Counts = {}
    unknown_frames: int = 0
    messages: Mapping[str, Counts] = {}
    sent: Mapping[str, Counts] = {}
    services: Counts = {}
    heartbeats: Counts = {}
    forwards: Mapping[str, Mapping[str, Any]] = {}
    guards: Mapping[str, Counts] = {}
    drives: tuple[Mapping[str, Any], ...] = ()
    lost_drives: tuple[str, ...] = ()
    drive_faults: int = 0
    buses: Mapping[str, Mapping[str, Any]] = {}
    journal_dropped: int = 0
    heard_dropped: int = 0
    injected: Mapping[int, int] = {}
    firmware: Mapping[str, str] = {}

    def write(self, folder: Path) -> None:
        """Into ``FOLDER/LIFE.json``, in one step. Raises RunError."""
        data = msgspec.json.format(msgspec.json.encode(self, enc_hook=str), indent=2)
        write_file(folder / self.life.file("json"), data + b"\n")

    @classmethod
    def read(cls, folder: Path, life: Life) -> Self | None:
        """The report of a life; None if it ended before it could write one."""
        path = folder / life.file("json")
        if not path.is_file():
            return None
        return msgspec.json.decode(path.read_bytes(), type=cls)

    @property
    def why(self) -> str:
        """The latched reasons in words, with what is known of the drives; "": none."""
        return reason_text(self.reasons, self.lost_drives)


def reason_text(reasons: Sequence[str], lost_drives: Sequence[str] = ()) -> str:
    """Names of bits of ``Why``, and sentences on drives, as one sentence; "": none."""
    bits = Why(0)
    for name in reasons:
        bits |= Why[name.upper()]
    return "; ".join(([explain(int(bits))] if bits else []) + list(lost_drives))


# ---- what a supervisor notes ---------------------------------------------------------------------


class _Note(Record, frozen=True, kw_only=True, tag_field="kind"):
    """Something noticed while a rehearsal runs, `t` s after its start."""

    t: float

    def describe(self) -> str:
        """A sentence on what happened."""
        raise NotImplementedError

    def __str__(self) -> str:
        """For people: ``t = 2.001 s: kill slave``."""
        return f"t = {self.t:.3f} s: {self.describe()}"


class Done(_Note, frozen=True, kw_only=True, tag="done"):
    """An event of a fault script was carried out; `index`: of its table, `by`: s, of a clock."""

    action: Action
    target: str
    index: int = -1
    by: float = 0.0

    def describe(self) -> str:
        """``kill slave``."""
        return f"{self.action} {self.target}"


class Remark(_Note, frozen=True, kw_only=True, tag="remark"):
    """A remark, as free text for the reader, by a program that runs a rehearsal from Python."""

    remark: str

    def describe(self) -> str:
        """The text of the remark."""
        return self.remark


class Gone(_Note, frozen=True, kw_only=True, tag="gone"):
    """A life ended without a planned cause; `signal`: that killed it, 0: none."""

    life: Life
    end: LifeEnd
    code: int = 0
    detail: str = ""

    def describe(self) -> str:
        """``node slave has ended: killed by SIGKILL``."""
        return f"node {self.life} has ended: {self.detail or self.end}"


class Missed(_Note, frozen=True, kw_only=True, tag="missed"):
    """A later life was not ready before the end of the run."""

    life: Life
    detail: str = ""

    def describe(self) -> str:
        """``node slave@2 was not ready before the end``."""
        return f"node {self.life} was not ready before the end" + (
            self.detail and f": {self.detail}"
        )


class Refused(_Note, frozen=True, kw_only=True, tag="refused"):
    """A life refused to arm or to start; `reasons`: names of the bits of ``Why``; `missing`: what
    it had not heard, and what its drives lacked.
    """

    life: Life
    reasons: tuple[str, ...]
    armed: bool = True
    missing: tuple[str, ...] = ()

    def describe(self) -> str:
        """``node slave@2 refuses to start: the arms are too far apart to start``."""
        why = refusal(self.reasons, self.armed, self.missing)
        return f"node {self.life} refuses to start: {why}"


class Deaf(_Note, frozen=True, kw_only=True, tag="deaf"):
    """A life received nothing of a message for too long; all were stopped. `to`: phrases."""

    life: Life
    to: tuple[str, ...]

    def describe(self) -> str:
        """``node slave hears nothing of xi_master from master for 10 s: all were stopped``."""
        return f"node {self.life} receives nothing from {', '.join(self.to)}: all were stopped"


class Lagged(_Note, frozen=True, kw_only=True, tag="lagged"):
    """A simulated bus of this host was behind the wall clock until `end` (s), by up to `late` s."""

    bus: str
    end: float
    late: float

    def describe(self) -> str:
        """``bus left was up to 1.50 s behind the wall clock, until 4.51 s``."""
        late = f"up to {self.late:.2f} s behind the wall clock"
        return f"bus {self.bus} was {late}, until {self.end:.2f} s"


Note: TypeAlias = Done | Remark | Gone | Missed | Refused | Deaf | Lagged


def note_of(facts: Mapping[str, Any]) -> Note:
    """A note from plain data, as its ``facts()`` gives it."""
    note: Note = msgspec.convert(facts, Note)
    return note


def record_note(what: str | FaultEvent, t: float) -> Note:
    """A note of something done to a rehearsal at `t` (s)."""
    if isinstance(what, str):
        return Remark(t=t, remark=what)
    return Done(t=t, action=what.action, target=what.target, index=what.index, by=what.by)


def refusal(reasons: Sequence[str], armed: bool, missing: Sequence[str] = ()) -> str:
    """The reason for which ARM or START was refused, as text; `missing`: what there was not."""
    if missing:
        return f"{refusal(reasons, armed)} ({'; '.join(missing)})"
    others = [name for name in reasons if name != "command"]
    if not others:
        return "not in this state" if armed else "not armed"
    return reason_text(others)


def reason_names(bits: int) -> tuple[str, ...]:
    """Names of the bits of ``Why`` that are set; those it does not have are left out."""
    return names(Why(bits & sum(Why)))
