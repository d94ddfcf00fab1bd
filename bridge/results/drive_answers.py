"""Checks that real drives were enabled, and answered the torques that they were sent.

A drive that is not enabled for all of a run, that reports another torque than it was sent, or whose
joint does not move as its torque asks, does not pass. Torques are compared as means of windows, so
a few ms of delay make no difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.can.codec import Codec
from bridge.deployment.cut import Outlet
from bridge.deployment.drive_messages import feedback_codec
from bridge.deployment.drive_sequences import commands
from bridge.deployment.system import System
from bridge.native.frame import Flags
from bridge.native.journal import Journal
from bridge.native.message import Decoded
from bridge.native.safety import LifeState
from bridge.records.node_lives import Life, frame_files
from bridge.records.records import LifeEnd
from bridge.results.drive_motion import WINDOW, JointMotion, TorqueAnswer, motions
from bridge.results.report import NodeReport
from bridge.safety.limits import per_joint
from bridge.wiring.wiring import Rows

#: Frames of reported torque that are decoded, the most of a drive; they are spread over the run.
FRAMES = 20_000
#: Share of the limit of a torque over which it has to range before friction, or an error of the
#: model of the other joints, cannot explain that a joint does not follow it.
STRONG = 0.2
#: Slots by which the silence of a drive at the end has to be longer than any before.
LONGER = 1.5
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class JointTorque:
    """The torques (n,) of one joint, N.m, and when they were sent (n,), ns of the run.

    `bit`: of its drive among those that its node commands, None for one of our own protocol.
    """

    name: str
    message: str
    law: str
    entry: int
    bit: int | None
    t_ns: NDArray[np.int64]
    tau: Array


def unanswered(
    system: System, rows_of: Mapping[Life, Rows], reports: Sequence[NodeReport], nodes: Path
) -> Iterator[str]:
    """A sentence for each real drive that was off, or did not answer its torques.

    `rows_of`: the rows (slots,) of each life; `nodes`: the folder with the logs of their buses.
    """
    for report, active, sent in _driving(system, rows_of, reports):
        plan = system.nodes[report.life.node]
        yield from _off(report.life, active, sent, plan.h)
        found = {(m.law, m.entry): m for m in motions(system, plan, active)}
        limits = _limits(system, report.life.node)
        for one in sent:
            start = report.statement.start_ns if report.statement else 0
            told = _reported(system, nodes, report.life, one, start) if start else None
            moved = found.get((one.law, one.entry))
            said = _said(one, told, moved, limits.get((one.law, one.entry), 0.0))
            if said:
                yield f"{report.life}: {one.name} {said}"


def silent_ends(
    system: System, rows_of: Mapping[Life, Rows], reports: Sequence[NodeReport]
) -> Iterator[str]:
    """A sentence for each drive that told nothing at the end of a run: it may have been off.

    It is one only if the drive was silent for longer than ever before, and did not tell that it was
    on while its node stopped. `rows_of`: the rows (slots,) of each life.
    """
    finished = [r for r in reports if r.end is LifeEnd.FINISHED]  # others say why they stopped
    for report, active, sent in _driving(system, rows_of, finished):
        rows = rows_of[report.life]
        stopping = rows[np.flatnonzero(rows["state"] == LifeState.ACTIVE)[-1] + 1 :]
        for one in sent:
            silence = _silence(system, report.life.node, active, stopping, one)
            if silence:
                yield (
                    f"{report.life}: {one.name} may have been off at the end: nothing came from it"
                    f" for {silence * 1e3:.0f} ms, and never for so long before"
                )


def _driving(
    system: System, rows_of: Mapping[Life, Rows], reports: Sequence[NodeReport]
) -> Iterator[tuple[NodeReport, Rows, list[JointTorque]]]:
    """Each life that has driven something: its ACTIVE slots (slots,), and the torques sent then."""
    for report in reports:
        rows = rows_of[report.life]
        active = _active(rows)
        if len(active) and (sent := list(_sent(system, report.life.node, active))):
            yield report, active, sent


def _active(rows: Rows) -> Rows:
    """The ACTIVE slots (slots,), without a copy of journals if they follow each other."""
    found = np.flatnonzero(rows["state"] == LifeState.ACTIVE)
    if found.size and found[-1] - found[0] == found.size - 1:
        return rows[found[0] : found[-1] + 1]
    return rows[found]


def _silence(system: System, node: str, active: Rows, stopping: Rows, one: JointTorque) -> float:
    """The silence of a drive at the end of its ACTIVE slots (slots,), s.

    0: it was as long before, the drive told in the slots after them (slots,) that it was on, or it
    is of our own protocol.
    """
    d, plan = system.deployment, system.nodes[node]
    command = d.messages[one.message]
    told = [
        k
        for k, inlet in enumerate(plan.inlets)
        if (spec := d.messages[inlet.message]).profile
        and (spec.bus, spec.drive) == (command.bus, command.drive)
    ]
    if one.bit is None or not told:
        return 0.0
    age, later = (rows["inlets"]["age_ns"][:, told].min(axis=1) for rows in (active, stopping))
    news = np.flatnonzero(np.diff(np.append(age, later)) <= 0) + 1  # slots with something new
    during, after = news[news < len(age)], news[news >= len(age)] - len(age)
    before = age[: during[-1]] if during.size else age
    if age[-1] - before.max(initial=0) <= LONGER * plan.h * 1e9:
        return 0.0
    if after.size and _is_on(stopping, one.bit)[after[0]]:
        return 0.0
    return float(age[-1] * 1e-9)


def _said(
    one: JointTorque, told: TorqueAnswer | None, moved: JointMotion | None, limit: float
) -> str:
    """The fault of a drive, its own report first; "": nothing."""
    if told is not None and told.reversed:
        return f"turns the wrong way: it reports a torque of {told}"
    if told is not None and told.absent:
        return f"follows nothing: it reports a torque of {told}"
    if moved is None or np.ptp(one.tau) < STRONG * limit:
        return ""
    if moved.still and limit > 0:
        peak = np.abs(one.tau).max()
        return f"or its encoder is stuck: no motion at all with torques up to {peak:.3g} N.m"
    if moved.held:
        return ""  # a hand decides how it moves
    if moved.answer.reversed:
        return f"turns the wrong way: its joint moves as if driven by {moved.answer}"
    follows = told is not None and told.judged
    if moved.answer.absent and not follows:
        return f"follows nothing: its joint moves as if driven by {moved.answer}"
    return ""


def _sent(system: System, node: str, rows: Rows) -> Iterator[JointTorque]:
    """The torques that a node sends, joint by joint, in the order of its drives."""
    d, plan = system.deployment, system.nodes[node]
    bits: dict[tuple[str, int], int] = {}
    first = 0
    for outlet in plan.outlets:
        spec, bit = d.messages[outlet.message], None
        if commands(d, outlet):
            bit = bits.setdefault((spec.bus, spec.drive), len(bits))
        for part in outlet.parts:
            whole = plan.plan.slots().get(f"{part.component}.{part.port}")
            for k in range(part.size if part.port == "tau" and whole is not None else 0):
                entry = part.start + k - (whole.start if whole else 0)
                name = _name(outlet, spec.drive if bit is not None else None, entry)
                yield JointTorque(
                    name, outlet.message, part.component, entry, bit,
                    rows["woke_ns"], rows["sent"][:, first + k],
                )  # fmt: skip
            first += part.size


def _name(outlet: Outlet, drive: int | None, entry: int) -> str:
    """A drive for people."""
    if drive is None:
        return f"the drive of joint {entry + 1}, which takes {outlet.message},"
    return f"drive {drive} on bus {outlet.bus}"


def _limits(system: System, node: str) -> dict[tuple[str, int], float]:
    """The limit of each torque that a guard has, N.m."""
    guard = system.deployment.nodes[node].guard
    found: dict[tuple[str, int], float] = {}
    if guard is None:
        return found
    for slot in system.nodes[node].plan.slots().values():
        if slot.port == guard.port:
            place = system.deployment.place("nodes", node, "guard")
            most = per_joint(guard.tau_max, slot.size, "N.m", place)
            values = [] if most is None else most.tolist()
            found |= {(slot.component, k): value for k, value in enumerate(values)}
    return found


def _off(life: Life, rows: Rows, sent: list[JointTorque], h: float) -> Iterator[str]:
    """Drives that were not enabled in slots in which their node was ACTIVE."""
    for one in sent:
        if one.bit is None:
            continue
        on = _is_on(rows, one.bit)
        if not on.all():
            at = np.flatnonzero(~on)
            yield (
                f"{life}: {one.name} was not enabled in {len(at)} of {len(on)} slots, first at "
                f"t = {int(rows['slot'][at[0]]) * h:.3f} s"
            )


def _is_on(rows: Rows, bit: int) -> NDArray[np.bool_]:
    """True if a drive was enabled in each slot (slots,), as in journals that do not tell."""
    if "serving" not in (rows.dtype.names or ()):
        return np.ones(len(rows), bool)  # of an earlier version
    on: NDArray[np.bool_] = rows["serving"] >> np.uint64(bit) & np.uint64(1) != 0
    return on


# ---- what drives report ---------------------------------------------------------------------


def _reported(
    system: System, nodes: Path, life: Life, one: JointTorque, start_ns: int
) -> TorqueAnswer | None:
    """The torque that a drive reports by the one it was sent; None: it reports none.

    `start_ns`: t = 0 of the run on the clock of the logs.
    """
    codec = feedback_codec(system.deployment, one.message, "tau") if one.bit is not None else None
    path = frame_files(nodes, system.deployment.messages[one.message].bus).get(life)
    if codec is None or path is None or not len(one.t_ns):
        return None
    log = Journal.open(path)
    mine = (log["id"] == codec.layout.identifier) & (log["flags"] & Flags.SENT == 0)
    sent_ns = start_ns + one.t_ns
    mine &= (log["t_ns"] > sent_ns[0]) & (log["t_ns"] <= sent_ns[-1])
    frames = log[mine]
    t, tau = _decoded(codec, frames[:: len(frames) // FRAMES + 1])
    if not len(t):
        return None
    at = np.searchsorted(sent_ns, t, side="right") - 1
    window = (t - t[0]) // round(WINDOW * 1e9)
    step = abs(codec.signals[0].scale)
    return TorqueAnswer.of(_means(one.tau[at], window), _means(tau, window), step)


def _decoded(codec: Codec, rows: NDArray[np.void]) -> tuple[NDArray[np.int64], Array]:
    """Stamps and torques (n,) of the frames that decode."""
    t, tau = [], []
    for row in rows:
        result, values, _ = codec.decode(row["data"][: int(row["length"])].tobytes())
        if result is Decoded.OK:
            t.append(int(row["t_ns"]))
            tau.append(float(values[0]))
    return np.array(t, np.int64), np.array(tau)


def _means(values: Array, window: NDArray[np.int64]) -> Array:
    """Means of the values in each window (n,)."""
    _, at = np.unique(window, return_inverse=True)
    found: Array = np.bincount(at, values) / np.bincount(at)
    return found
