"""Comparison of one run of a campaign with its expected outcome.

Whatever a script does: no corrupted frame was accepted, no torque was beyond its limits, the run
folder is there, and the replay is the run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bridge.campaign.spec import CampaignRunSpec
from bridge.can.codec import Codec
from bridge.deployment.carried import Carried
from bridge.deployment.system import System
from bridge.native import message as messages
from bridge.native.bus import Accept
from bridge.native.journal import Journal
from bridge.native.message import counter_bits
from bridge.native.safety import Why
from bridge.records.node_lives import Life, lives_of
from bridge.records.records import LifeEnd
from bridge.results import undetected as injected
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.report import NodeReport
from bridge.safety.limits import names, per_joint
from bridge.wiring.wiring import HEARD, Rows
from cosim.base.markdown import markdown_row
from cosim.record.folder import NODES

#: Counters of what a receiver refuses because of a frame's content.
REFUSED = ("crc", "length", "invalid", "range")
#: ns between the arrivals of a sample and of the corrupted frame that it is taken for, at most.
APART = 1_000_000


@dataclass(frozen=True, slots=True)
class JudgedRun:
    """A row of a campaign's table; `failures`: what had to be otherwise; none: passed.

    `ended`: what became of the nodes that did not finish; `seen`: counters of receivers that are
    not 0, summed; `corrupted`: frames corrupted and received, `undetected`: those accepted all the
    same; `torque`: greatest share of its limit that any torque had; `exact`: the replay is the run,
    `replay`: how it differs, for people.
    """

    script: str
    ended: Mapping[str, str]
    seen: Mapping[str, int]
    corrupted: int
    undetected: int
    torque: float
    exact: bool
    replay: str
    failures: tuple[str, ...]


def failed_run(script: str, error: Exception) -> JudgedRun:
    """A run that came to nothing."""
    return JudgedRun(Path(script).stem, {}, {}, 0, 0, 0.0, False, "", (f"no run: {error}",))


def judge(system: System, spec: CampaignRunSpec, outcome: RehearsalOutcome) -> JudgedRun:
    """Evaluate a run folder and the statement about it."""
    ended = dict(_unfinished_lives(system, outcome))
    seen = _seen(outcome)
    found = [_corrupted(system, outcome, report) for report in outcome.reports]
    corrupted, undetected = (sum(part[i] for part in found) for i in (0, 1))
    torque = max(_shares(system, outcome.rows), default=0.0)
    exact = outcome.replayed is not None and outcome.replayed.first is None
    judged = JudgedRun(
        Path(spec.script).stem,
        ended,
        seen,
        corrupted,
        undetected,
        torque,
        exact,
        "0" if exact else outcome.replay_error or f"{outcome.replayed}",
        (),
    )
    return JudgedRun(
        **{f: getattr(judged, f) for f in JudgedRun.__slots__ if f != "failures"},
        failures=(
            *_expected(system, spec, outcome, judged),
            *_broken_invariants(system, outcome, judged),
        ),
    )


# ---- what had to come -----------------------------------------------------------------------


def _expected(
    system: System, spec: CampaignRunSpec, outcome: RehearsalOutcome, judged: JudgedRun
) -> Iterator[str]:
    """Differences between the outcome that the campaign expects of this run and the actual one."""
    if spec.ends == "finished" and not outcome.finished:
        yield f"expected to finish; {_said(judged.ended)}"
    if spec.ends == "stopped":
        stopped = [
            report
            for report in outcome.reports
            if str(report.life) in judged.ended and spec.node in ("", report.life.node)
        ]
        if not stopped:
            yield f"expected {spec.node or 'a node'} to stop; {_said(judged.ended)}"
        elif spec.because and not any(reasons(outcome, r) & set(spec.because) for r in stopped):
            yield f"expected {' or '.join(spec.because)}; {_said(judged.ended)}"
    for name in spec.sees:
        if not judged.seen.get(name):
            yield f"expected frames counted as {name}; none were"


def _broken_invariants(
    system: System, outcome: RehearsalOutcome, judged: JudgedRun
) -> Iterator[str]:
    """Statements that hold in every good run and do not hold in this one."""
    if judged.undetected:
        yield f"{judged.undetected} corrupted frames accepted"
    if not judged.torque <= 1.0:
        yield f"a torque of {judged.torque:.3g} times its limit"
    if not judged.exact:
        yield f"replay: {judged.replay}"
    for fault in outcome.faults:
        if fault.verdict == "unseen":
            yield f"no report shows fault {fault.index}: {fault.text()}"
    missing = {node for node in system.nodes if not lives_of(outcome.rows, node)}
    missing |= {
        f for f in ("run.json", "trajectories.parquet") if not (outcome.folder / f).is_file()
    }
    if missing:
        yield f"not in the run folder: {', '.join(sorted(missing))}"


def _said(ended: Mapping[str, str]) -> str:
    return "; ".join(f"{life}: {why}" for life, why in ended.items()) or "all finished"


def reasons(outcome: RehearsalOutcome, report: NodeReport) -> set[str]:
    """Names of everything that stopped a life."""
    return set(names(Why(int(outcome.rows[report.life]["reasons"][-1]))))


def _unfinished_lives(system: System, outcome: RehearsalOutcome) -> Iterator[tuple[str, str]]:
    """Each life that did not finish, and why in one word or two."""
    for report in outcome.reports:
        if report.end is not LifeEnd.FINISHED:
            why = ", ".join(sorted(reasons(outcome, report)))
            yield str(report.life), f"{report.end} ({why})" if why else str(report.end)


def _seen(outcome: RehearsalOutcome) -> dict[str, int]:
    total: dict[str, int] = {}
    for report in outcome.reports:
        for counts in (report.statement.messages if report.statement else {}).values():
            for name, count in counts.items():
                if count and name != "ok":
                    total[name] = total.get(name, 0) + count
    return total


# ---- corrupted frames -----------------------------------------------------------------------


def _corrupted(system: System, outcome: RehearsalOutcome, report: NodeReport) -> tuple[int, int]:
    """(frames corrupted on their way to a node, frames among them that it accepted).

    Two conditions are checked: no sequence number of a corrupted frame was accepted when that frame
    arrived; and a receiver with a report refused as many frames as were corrupted.
    """
    path = outcome.folder / NODES / report.life.file("faults")
    if not path.is_file():
        return 0, 0
    record, total, accepted = Journal.open(path), 0, 0
    for name in system.received_by(report.life.node):
        carried = system.messages[name]
        bus = system.buses_of(report.life.node).index(carried.bus)
        rows = record[record["bus"] == bus]
        rows = injected.corrupted_frames(rows, Accept.of(carried.encoding.message))
        if not len(rows):
            continue
        copies = int(rows["copies"].sum())
        counts = report.statement.messages.get(name) if report.statement else None
        refused = sum(counts[r] for r in REFUSED) if counts else copies
        first = _accepted(system, outcome, report, name)
        numbers = _sequences(rows, carried)
        arrived = np.array([first.get(int(n), -1) for n in numbers], dtype=np.int64)
        # What came at another time is another frame of that number: a node that begins again counts
        # from 0 until it is started, and a gateway sends a sample again while it has no newer one.
        there = (arrived >= rows["t_ns"] - APART) & (arrived <= rows["through_ns"] + APART)
        bad = injected.undetected(numbers[there & (arrived >= 0)], first)
        total += copies
        accepted += max(len(bad), copies - refused, 0)
    return total, accepted


def _sequences(rows: Rows, carried: Carried) -> NDArray[np.int64]:
    """Sequence numbers of the frames of a record, as they were before they were corrupted."""
    profile = messages.E2EProfile(carried.encoding.message.e2e)
    assert isinstance(carried.encoding, Codec)
    ids = bytes(carried.encoding.message.data_ids)
    return injected.sequences(
        rows,
        lambda data: messages.check(profile, ids, data)[1],
        counter_bits(profile),
        carried.period_ns,
        carried.offset_ns,
    )


def _accepted(
    system: System, outcome: RehearsalOutcome, report: NodeReport, message: str
) -> dict[int, int]:
    """The arrival (ns) at which each sequence number was first accepted."""
    path = outcome.folder / NODES / report.life.file(HEARD)
    rows = Journal.open(path)
    mine = rows[rows["message"] == system.received_by(report.life.node).index(message)]
    numbers, at = np.unique(mine["sequence"], return_index=True)
    times = mine["arrival_ns"][at]
    return {int(n): int(t) for n, t in zip(numbers, times, strict=True)}


# ---- torques --------------------------------------------------------------------------------


def _shares(system: System, rows: Mapping[Life, Rows]) -> Iterator[float]:
    """The greatest share of `tau_max` in each row, for every guarded torque that was sent."""
    for life, recorded in rows.items():
        name = life.node
        spec = system.deployment.nodes[name].guard
        first = 0
        for outlet in system.nodes[name].outlets:
            for part in outlet.parts:
                if spec is not None and part.port == spec.port and spec.tau_max is not None:
                    limit = per_joint(spec.tau_max, part.size, "N.m", f"{name}.guard.tau_max")
                    sent = np.abs(recorded["sent"][:, first : first + part.size]) / limit
                    yield float(np.nan_to_num(sent, nan=np.inf).max(initial=0.0))
                first += part.size


# ---- the table ------------------------------------------------------------------------------


def table(judged: list[JudgedRun]) -> list[list[str]]:
    """Rows of text, the heading first."""
    head = ["script", "nodes that did not finish", "receivers counted", "corrupted", "accepted"]
    rows = [[*head, "torque", "replay", "as expected"]]
    for j in judged:
        rows.append(
            [
                j.script,
                "; ".join(f"{life} {why}" for life, why in j.ended.items()) or "none",
                ", ".join(f"{n} {k.replace('_', ' ')}" for k, n in j.seen.items()) or "nothing",
                str(j.corrupted),
                str(j.undetected),
                f"{j.torque:.0%}",
                j.replay,
                "yes" if not j.failures else "NO: " + "; ".join(j.failures),
            ]
        )
    return rows


def markdown(rows: list[list[str]]) -> str:
    """A table of Markdown."""
    lines = [markdown_row(cells) for cells in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]) + "\n"
