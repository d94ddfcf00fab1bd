"""Evidence of faults of drives: what the node that commands a drive was told, or missed.

A fault acts where its node wants the drive, or hears it: it is *seen* if the node gave the drive up
or was told an error, if answers were missing or late, or if positions stood still that had moved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.carried import Carried
from bridge.deployment.drive_sequences import Foreign, commanded_drives, own_torques
from bridge.faults.script import DriveFault, FaultScript
from bridge.native.bus import Accept
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.native.safety import LifeState, Why
from bridge.native.vendor import VendorFault
from bridge.records.node_lives import Life, frame_files
from bridge.results.findings import Evidence, Place, Sign
from bridge.results.symptoms import FinishedRun
from bridge.wiring.wiring import Rows

Times = NDArray[np.float64]
#: Times of the usual gap between two answers that a gap has to have, and frames that show it.
LONGER, FRAMES = 1.5, 20
#: rad by which a joint has to move before it tells something new.
MOVED = 0.005
#: Faults after which answers are missing, or late.
SILENT = (VendorFault.LATE, VendorFault.UNPLUG, VendorFault.OTHER_ID, VendorFault.REBOOT)
#: What a node missed, by the name of the failure for which it gave a drive up.
_MISSED = {
    "silent": "nothing any more",
    "still": "positions that stand still",
    "number": "the number of another drive",
    "format": "frames of another format",
    "value": "another value of a register",
}


def drive_evidence(script: FaultScript, shown: FinishedRun) -> Iterator[Evidence]:
    """The evidence of each table of a script about drives; `shown`: the run."""
    end = shown.system.plan.ticks * shown.system.plan.h
    tables: dict[int, dict[tuple[str, int], list[DriveFault]]] = {}
    for one in script.drives:
        tables.setdefault(one.index, {}).setdefault((one.bus, one.drive), []).append(one)
    for index, drives in tables.items():
        faults = [events[0] for events in drives.values()]
        ends = [events[1].t if len(events) > 1 else end for events in drives.values()]
        places = [p for e in drives.values() for p in _places(e, shown, end)]
        does = faults[0].fault.name.lower().replace("_", "-")
        yield Evidence(
            index=index,
            kind="drive",
            targets=[f"drive {f.drive} on bus {f.bus} ({does})" for f in faults],
            t0=faults[0].t,
            t1=min(max(ends), end),
            places=places,
        )


def _places(events: Sequence[DriveFault], shown: FinishedRun, end: float) -> Iterator[Place]:
    """A place for each life that commands the drive."""
    fault, t1 = events[0], events[1].t if len(events) > 1 else end
    yield from _own_places(fault, t1, shown)
    for node, plan in shown.system.nodes.items():
        drives = commanded_drives(shown.system.deployment, plan)
        for bit, drive in enumerate(drives):
            if (drive.bus, drive.node) != (fault.bus, fault.drive):
                continue
            for life in shown.lives(node):
                host = _host(shown, life, drive, bit)
                if host is not None:
                    signs = tuple(host.signs(fault, t1))
                    done = int(bool(signs) or host.acts(fault, t1))
                    yield Place(target=drive.name, message="", done=done, signs=signs)


def _own_places(fault: DriveFault, t1: float, shown: FinishedRun) -> Iterator[Place]:
    """A place for each life of the node that is a drive of our own protocol with this number."""
    for node, spec in shown.system.deployment.nodes.items():
        here = spec.number == fault.drive and fault.bus in shown.system.buses_of(node)
        if not here or not own_torques(shown.system.deployment, node, shown.system.nodes[node]):
            continue
        for life in shown.lives(node):
            rows = shown.rows[life]
            t, state = rows["deadline_ns"] * 1e-9, rows["state"]
            acts = (t >= fault.t) & (t <= t1) & (state == LifeState.ACTIVE)
            off = np.flatnonzero((t >= fault.t) & (rows["now"] & np.uint32(Why.DRIVE) != 0))
            said = f"that the drive of {life} is off"
            signs = [Sign(what="told", life=life, number=float(t[i]), said=said) for i in off[:1]]
            done = int(bool(signs or acts.any()))
            yield Place(
                target=f"drive {fault.drive} on bus {fault.bus}", done=done, signs=tuple(signs)
            )


@final
@dataclass(frozen=True, slots=True)
class _Host:
    """A life with slots of `h` s that commands a drive: what it did with it, and heard of it.

    `changes`: of the drive, of its node's statement, `others`: of all drives of its bus. `slots`:
    when (s) the node had slots, `wanted`: whether it gave the drive torque then, or brought it up.
    `state`, `position`: arrivals (s) of frames with its state and its position, `data`: of these.
    `joint`: where (rad) the joint was at the times `joint_t` (s), where it is emulated.
    """

    life: Life
    h: float
    drive: Foreign
    changes: Sequence[Mapping[str, Any]]
    others: Sequence[Mapping[str, Any]]
    slots: Times
    wanted: NDArray[np.bool_]
    state: Times
    position: Times
    data: Sequence[bytes]
    joint: Times
    joint_t: Times

    def signs(self, fault: DriveFault, t1: float) -> Iterator[Sign]:
        """The signs of the fault, which is over at `t1` (s)."""
        told = self._told(fault)
        if told:
            yield Sign(what="told", life=self.life, number=told["t"], said=told_words(told))
        if fault.fault in SILENT:
            gap = self._gap(fault.t, t1)
            if gap:
                yield Sign(what="silence", number=gap)
        if fault.fault is VendorFault.DROP and (late := self._brought_up_late(fault.t, t1)):
            yield Sign(what="waited", number=late)
        if fault.fault is VendorFault.OLD and self._moves(fault.t, t1) and self._still(fault.t, t1):
            yield Sign(what="still", number=min(t1, float(self.slots[-1])) - fault.t)

    def _told(self, fault: DriveFault) -> Mapping[str, Any] | None:
        """The first change after the fault by which the node gave the drive up or saw an error."""
        errors = [s.name for s in self.drive.profile.status.states if s.kind == "fault"]
        known = self.others if fault.fault is VendorFault.OTHER_ID else self.changes
        for one in known:
            if one["t"] >= fault.t and (
                one["phase"] == "failed" or any(one["told"].startswith(name) for name in errors)
            ):
                return one
        return None

    def acts(self, fault: DriveFault, t1: float) -> bool:
        """True if the fault can have had an effect that this life had to notice."""
        if not len(self.slots) or self.slots[-1] + self.h < fault.t or self._lost(fault.t):
            return False
        if fault.fault is VendorFault.OLD:
            return self._moves(fault.t, t1) and self._wants(fault.t, t1)
        if fault.fault is VendorFault.DROP:
            return self._enables(fault.t, t1)
        if fault.fault in (VendorFault.TRIP, VendorFault.HOT):
            return self._wants(fault.t, t1) or bool((self.state > fault.t).any())
        return self._wants(fault.t, t1)

    def _enables(self, t0: float, t1: float) -> bool:
        """True if a bring-up began and came to its end in this time."""
        began = [c["t"] for c in self._begun(t0, t1)]
        ended = [c["t"] for c in self.changes if c["phase"] in ("serving", "failed")]
        return bool(began) and any(began[0] < t <= t1 for t in ended)

    def _begun(self, t0: float, t1: float) -> list[Mapping[str, Any]]:
        """The bring-ups that began in this time."""
        begun = [c for c in self.changes if c["phase"] == "rising" and not c["told"]]
        return [c for c in begun if t0 <= c["t"] <= t1]

    def _lost(self, t: float) -> bool:
        """True if the node had given the drive up before."""
        before = [c for c in self.changes if c["t"] < t]
        return bool(before) and before[-1]["phase"] == "failed"

    def _wants(self, t0: float, t1: float) -> bool:
        """True if the node gave it torque or brought it up in this time."""
        return bool(self.wanted[(self.slots > t0 - self.h) & (self.slots <= t1)].any())

    def _gap(self, t0: float, t1: float) -> float:
        """The longest time without a position in which the node wanted the drive; 0: as usual.

        Usual is what was before, or else what came after it.
        """
        wanted = self.slots[self.wanted & (self.slots >= t0)]
        usual = np.diff(self.position[self.position < t0][-FRAMES:])
        usual = usual if len(usual) else np.diff(self.position[self.position >= t0][:FRAMES])
        if not len(usual) or not len(wanted):
            return 0.0
        there = self.position[(self.position > wanted[0]) & (self.position < wanted[-1])]
        at = np.concatenate([wanted[:1], there, wanted[-1:]])
        at = at[: int(np.searchsorted(at, t1, side="right")) + 1]
        slots = np.diff(np.searchsorted(wanted, at, side="right"))
        longest = float(slots.max(initial=0)) * self.h
        return longest if longest >= LONGER * float(np.median(usual)) else 0.0

    def _still(self, t0: float, t1: float) -> bool:
        """True if the same was told in all frames of this time but the first."""
        said = {d for t, d in zip(self.position, self.data, strict=True) if t0 < t <= t1}
        return 0 < len(said) <= 2

    def _moves(self, t0: float, t1: float) -> bool:
        """True if the joint moved in this time, as far as it is known: a real one is not."""
        there = self.joint[(self.joint_t >= t0) & (self.joint_t <= t1)]
        return bool(len(there)) and float(np.ptp(there)) > MOVED

    def _brought_up_late(self, t0: float, t1: float) -> float:
        """Time (s) from a bring-up that began in this time until the drive was enabled after it."""
        began = [c["t"] for c in self._begun(t0, t1)]
        ready = [c["t"] for c in self.changes if c["phase"] == "serving" and c["t"] > t1]
        return ready[0] - began[-1] if began and ready else 0.0


def _host(shown: FinishedRun, life: Life, drive: Foreign, bit: int) -> _Host | None:
    """The part of a life's report on a drive; None: it has not reported."""
    said, log = shown.statement(life), frame_files(shown.nodes, drive.bus).get(life)
    if said is None or log is None:
        return None
    rows = shown.rows[life]
    frames = Journal.open(log)
    frames = frames[frames["flags"] & Flags.SENT == 0]
    state = frames[drive.status.among(frames)] if drive.profile.status.message else frames[:0]
    told = _told_by(shown, drive)
    position = frames[Accept.of(told.encoding.message).among(frames)] if told else frames[:0]
    if len(position) and drive.status.among(position[:1])[0]:
        position = position[[_is_state(drive, row) for row in position]]
    joint, joint_t = _joint(shown, told)
    of_bus = [c for c in said.drives if c["drive"].endswith(f"on bus {drive.bus}")]
    changes = [c for c in of_bus if c["drive"] == drive.name]
    slots = rows["deadline_ns"] * 1e-9
    serving = (rows["serving"] >> np.uint64(bit) & np.uint64(1)) != 0
    return _Host(
        life, shown.system.nodes[life.node].h, drive, changes, of_bus, slots,
        serving | _rising(slots, changes),
        (state["t_ns"] - said.start_ns) * 1e-9, (position["t_ns"] - said.start_ns) * 1e-9,
        _payloads(position), joint, joint_t,
    )  # fmt: skip


def _told_by(shown: FinishedRun, drive: Foreign) -> Carried | None:
    """The message in which a drive tells its position."""
    for name, carried in shown.system.messages.items():
        spec = shown.system.deployment.messages[name]
        mine = spec.profile and (spec.bus, spec.drive) == (drive.bus, drive.node)
        if mine and any(part.port == "q" for part in carried.outlet.parts):
            return carried
    return None


def _is_state(drive: Foreign, row: np.void) -> bool:
    """True if a frame is no answer of a register, which has the same identifier."""
    state = drive.profile.status.at(int.from_bytes(row["data"][:8].tobytes(), "little"))
    return state is None or state.kind != "other"


def _joint(shown: FinishedRun, told: Carried | None) -> tuple[Times, Times]:
    """Positions (n,), rad, of a message's joint by the rows of its sender, and times (n,), s."""
    lives = shown.lives(told.node) if told else []
    if told is None or not lives:
        return np.zeros(0), np.zeros(0)
    part = next(part for part in told.outlet.parts if part.port == "q")
    rows = [shown.rows[life] for life in lives]
    q = np.concatenate([r["signals"][:, part.start] for r in rows])
    return q, np.concatenate([r["deadline_ns"] * 1e-9 for r in rows])


def _rising(slots: Times, changes: Sequence[Mapping[str, Any]]) -> NDArray[np.bool_]:
    """In which slots (n,) the node brought a drive up."""
    phases = np.array(["resting", *(c["phase"] for c in changes)])
    found: NDArray[np.bool_] = phases[np.searchsorted([c["t"] for c in changes], slots)] == "rising"
    return found


def _payloads(frames: Rows) -> list[bytes]:
    """Data of frames without the first byte, where some drives tell their state."""
    return [row["data"][1 : int(row["length"])].tobytes() for row in frames]


def told_words(change: Mapping[str, Any]) -> str:
    """The state that a drive told a node, or that it missed, in words."""
    return _MISSED.get(change["failure"], "") or str(change["told"] or "nothing")
