"""Drives with protocols of their own that a node commands, as tables for ``bridge/c/bringup.c``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, final

from bridge.deployment.drive_sequences import Foreign, drive_names, feed_ns
from bridge.deployment.system import System
from bridge.drives.raw_frames import Raw
from bridge.native.bus import KIND, Accept
from bridge.native.commanded import (
    CommandedStruct,
    DriveEvent,
    Failure,
    Lacks,
    Phase,
    StepKind,
    StepStruct,
    ToldStruct,
)
from bridge.native.frame import Flags, Frame
from bridge.native.node import WALL, NodeStruct
from bridge.safety.limits import to_si
from cosim.base.errors import ScenarioError

#: The most drives of a node: a row of its journal has a bit for each.
DRIVES = 64
#: Changes of drives that are kept of a run.
EVENTS = 4096


@final
class CommandedDrives:
    """Binds the drives that a node commands to its struct, and keeps the memory that they use.

    `drives` in the order of the bits in a row of the journal; `buses`: names, by number.
    """

    def __init__(
        self, drives: Sequence[Foreign], buses: Sequence[str], struct: NodeStruct, place: str
    ) -> None:
        if len(drives) > DRIVES:
            raise ScenarioError(f"commands {len(drives)} drives, expected at most {DRIVES}", place)
        self.drives, self._buses = tuple(drives), buses
        self._alive: list[Any] = []
        self._struct = struct
        self.structs = (CommandedStruct * max(1, len(drives)))()
        for drive, entry in zip(drives, self.structs, strict=False):
            self._bind(drive, entry)
        self._events = (DriveEvent * EVENTS)() if drives else None
        struct.commanded, struct.n_commanded = self.structs, len(drives)
        struct.feed_ns = feed_ns(drives)
        struct.fed_ns = -(1 << 62)
        if self._events is not None:
            struct.drive_events.events = self._events
            struct.drive_events.capacity = EVENTS

    def watch(self, system: System, receptions: Iterable[str]) -> None:
        """Let the node compare positions of its drives with their velocities.

        `receptions`: the messages that it receives, in the order of their numbers.
        """
        for number, name in enumerate(receptions):
            spec, at = system.deployment.messages[name], 0
            index = self.index(spec.bus, spec.drive) if spec.profile else -1
            for part in system.messages[name].outlet.parts if index >= 0 else ():
                entry = self.structs[index]
                if part.port == "q" and part.size == 1:
                    entry.q_of, entry.q_at = number, at
                if part.port == "dq" and part.size == 1:
                    entry.dq_of, entry.dq_at = number, at
                at += part.size

    def index(self, bus: str, node: int) -> int:
        """The place of a drive among them; -1: it is not commanded by this node."""
        found = [i for i, d in enumerate(self.drives) if (d.bus, d.node) == (bus, node)]
        return found[0] if found else -1

    def given_up(self) -> list[str]:
        """A sentence for the drives that their node gave up, those with the same reason in one."""
        return self._sentences(lambda s: s.failure != Failure.NOT)

    def not_ready(self) -> list[str]:
        """The same of drives that were not ready when START was refused last."""
        return self._sentences(lambda s: s.lacks != Lacks.NOTHING)

    def _sentences(self, chosen: Callable[[CommandedStruct], bool]) -> list[str]:
        found: dict[tuple[str, str], list[int]] = {}
        for drive, s in zip(self.drives, self.structs, strict=False):
            if chosen(s):
                found.setdefault((drive.bus, _reason(drive, s)), []).append(drive.node)
        return [f"{drive_names(numbers, bus)} {text}" for (bus, text), numbers in found.items()]

    def events(self) -> list[dict[str, Any]]:
        """Reports of drives, and actions of their node, in the order of time (JSON)."""
        kept = min(int(self._struct.drive_events.n), EVENTS)
        found = []
        for event in (self._events or ())[:kept]:
            drive = self.drives[event.drive]
            phase, failure = Phase(event.phase), Failure(event.failure)
            found.append(
                {
                    "t": (event.t_ns - self._struct.start_ns) * 1e-9,
                    "drive": drive.name,
                    "phase": phase.name.lower(),
                    "told": _told(drive, event.row, event.word),
                    "failure": failure.name.lower() if phase is Phase.FAILED else "",
                }
            )
        return found

    # ---- tables --------------------------------------------------------------------------------

    def _bind(self, drive: Foreign, entry: CommandedStruct) -> None:
        profile, status = drive.profile, drive.profile.status
        entry.bus, entry.row, entry.told_ns = self._buses.index(drive.bus), -1, -1
        entry.q_of = entry.dq_of = entry.q_newest = -1
        entry.format = int(profile.format & Flags.FD)
        entry.feeds = profile.watchdog.fed_by in ("frame", "torque")
        entry.feed = self._frame(drive, *drive.torque(0.0))
        # in simulated time the drives of vendors tell their state; others are mirrors that may not
        told = self._struct.clock == WALL or drive.profile.vendor
        entry.within_ns = round(status.within * 1e9) if told else 0
        if status.message:
            entry.status = drive.status
            entry.own_mask, entry.own = status.number, status.own(drive.node)
        rows = [ToldStruct(s.mask, s.value, s.meaning, s.differs) for s in status.states]
        entry.told, entry.n_told = self._array(ToldStruct, rows)
        steps = [self._step(drive, step) for step in drive.steps()]
        entry.steps, entry.n_steps = self._array(StepStruct, steps)
        off = [self._frame(drive, *raw.at(drive.node)) for raw in profile.sequences["disable"]]
        entry.disabling, entry.n_disabling = self._array(Frame, off)

    def _array(self, kind: Any, entries: Sequence[Any]) -> tuple[Any, int]:
        found = (kind * max(1, len(entries)))(*entries)
        self._alive.append(found)
        return found, len(entries)

    def _frame(self, drive: Foreign, identifier: int, data: bytes) -> Frame:
        frame = drive.frame(identifier, data)
        frame.bus = self._buses.index(drive.bus)
        return frame

    def _step(self, drive: Foreign, step: Raw | tuple[Raw, Raw]) -> StepStruct:
        raw, reply = step if isinstance(step, tuple) else (step, None)
        value = drive.watchdog_value
        found = StepStruct(frame=self._frame(drive, *raw.at(drive.node, value)))
        found.within_ns, found.again_ns = (
            round(to_si(x, "s", drive.profile.path) * 1e9) for x in (raw.within, raw.again)
        )
        if reply is not None:
            found.kind = StepKind.FRAME
            identifier, data = reply.at(drive.node, value)
            found.answer = Accept(identifier, flag_mask=KIND)
            exact = reply.value_mask(drive.node)
            found.value, found.exact = int.from_bytes(data, "little"), exact
            found.mask = ((1 << 8 * len(data)) - 1) & ~exact
        elif raw.expect and drive.profile.status.message:
            found.kind = StepKind.STATE
            found.states = drive.profile.status.bits(raw.expect)
        return found


def _reason(drive: Foreign, s: CommandedStruct) -> str:
    """The reason for which a drive gets no torque, as the rest of a sentence about it."""
    failure, status = Failure(s.failure), drive.profile.status
    if failure is Failure.NOT:
        return _lacking(drive, s)
    told = status.describe(int(s.failed_word)) if s.heard else "nothing"
    match failure:
        case Failure.ANSWER:
            expected = " or ".join(drive.expected(s.failed_step)) or "an answer"
            return f"did not follow: expected {expected}, it tells {told}"
        case Failure.VALUE:
            return f"is not enabled: its {drive.wrong_value(int(s.failed_word))}"
        case Failure.SILENT:
            return f"has told nothing for too long, at last {told}"
        case Failure.FORMAT:
            kinds = ("classic CAN", "CAN FD")
            found, expected = kinds if Flags.FD in drive.profile.format else reversed(kinds)
            cure = "set its bit rate or take another profile"
            return f"answers with frames of {found}, expected {expected}: {cure}"
        case Failure.STILL:
            return "sends old positions: they stand still while its velocity says that it moves"
        case Failure.NUMBER:
            number = f"{int(s.failed_word) & status.number:#x}"
            return f"answers with the number of another drive ({number})"
    return f"tells {told}, expected an enabled state"


def _lacking(drive: Foreign, s: CommandedStruct) -> str:
    if Lacks(s.lacks) is Lacks.POSITION:
        age = f"for {s.position_ns * 1e-6:.0f} ms" if s.position_ns >= 0 else "yet"
        return f"has told no position {age}"
    return f"has not been brought up: it tells {_told(drive, s.row, s.word) or 'nothing'}"


def _told(drive: Foreign, row: int, word: int) -> str:
    return drive.profile.status.describe(int(word)) if row >= 0 else ""
