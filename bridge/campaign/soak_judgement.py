"""Evaluation of one run of a soak test or campaign: numbers, deviations and verdict."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bridge.campaign import judgement
from bridge.campaign.judgement import JudgedRun
from bridge.campaign.soak_spec import Soak
from bridge.deployment.system import System
from bridge.faults.script import HOSTILE, FaultScript
from bridge.native.safety import LifeState
from bridge.node.handle import NodeHandle
from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Missed, Refused
from bridge.results.rehearsal_outcome import RehearsalOutcome
from bridge.results.verdict import OF_TIME, Verdict, Word, of_time
from bridge.wiring.wiring import Rows
from cosim.measure import declared_metrics
from cosim.measure.metrics import evaluate
from cosim.record import Run
from cosim.record.folder import NODES

#: What a node may stop for, by the kind of fault that explains it; of "": any. A drive that hears
#: nothing trips its watchdog, and the node that commands it stops when it tells so.
STOPS: Mapping[str, frozenset[str]] = {
    "": frozenset({"stale", "watchdog", "drive", "peer", "sync", "jump"}),
    "freeze": frozenset({"overrun"}),
    "clock-jump": frozenset({"overrun"}),
    "restart": frozenset({"apart"}),
    **dict.fromkeys(HOSTILE, frozenset({"guard", "component"})),
}
#: What a process says on standard error when it has crashed.
CRASHED = ("Traceback (most recent", "panicked at", "Fatal Python error", "Segmentation fault")


@dataclass(frozen=True, slots=True)
class RunDone:
    """A finished run, with all data needed to evaluate it."""

    system: System
    script: FaultScript
    outcome: RehearsalOutcome
    judged: JudgedRun
    lives: Sequence[NodeHandle]


def judge_soak_run(soak: Soak, done: RunDone, measures: Mapping[str, float]) -> Verdict:
    """The verdict on a run of a soak; inconclusive if only the lateness of the machine shows.

    `measures`: by name, each in the unit of its limit.
    """
    found, timed = (
        list(_broken_invariants(soak, done, measures)),
        list(_timed(soak, done, measures)),
    )
    if found:
        return Verdict(Word.FAILED, (*found, *timed))
    return of_time(done.system, done.outcome, timed) if timed else Verdict(Word.PASSED)


def run_numbers(soak: Soak, done: RunDone) -> dict[str, float]:
    """Numbers of a run: faults by kind, torque (N.m), slots missed, lateness (ms), …"""
    found: dict[str, float] = {"s": done.system.plan.ticks * done.system.plan.h}
    for fault in done.outcome.faults:
        for what in ("injected", fault.verdict):
            key = f"{fault.kind}.{what}"
            found[key] = found.get(key, 0.0) + 1.0
    reports = done.outcome.reports
    found |= {
        "crashes": float(len(list(_crashes(done)))),
        "corrupted": float(done.judged.corrupted),
        "accepted": float(done.judged.undetected),
        "torque": torque(done.system, done.outcome.rows),
        "slots": float(sum(r.slots for r in reports)),
        "missed": float(sum(r.lateness.missed for r in reports)),
        "late_p99_ms": max(r.lateness.late.p99 for r in reports) * 1e-6,
        "lives": float(len(done.lives)),
        "stopped": float(sum(r.end is LifeEnd.FAULT for r in reports)),
    }
    if soak.spec.together is not None:
        found["together"] = _arm_distance(soak, done)
    return found


def torque(system: System, rows: Mapping[Life, Rows]) -> float:
    """Return the greatest torque that was sent, N.m: after the guard, or computed without a guard.

    `rows`: the rows (slots,) of each life. NaN if a torque was NaN.
    """
    worst = [0.0]
    for life, recorded in rows.items():
        name = life.node
        worst += _sent(system, name, recorded)
        for step in system.nodes[name].plan.components:
            if step.kind != "sampled" or system.deployment.nodes[name].guard is not None:
                continue
            for slot in step.outputs:
                if slot.unit == "N.m":
                    values = recorded["signals"][:, slot.start : slot.start + slot.size]
                    worst.append(float(np.abs(values).max(initial=0.0)))
    return float(np.max(worst))


def _sent(system: System, name: str, recorded: Rows) -> Iterator[float]:
    """The greatest value of each torque a node has sent behind its guard."""
    guard, first = system.deployment.nodes[name].guard, 0
    for outlet in system.nodes[name].outlets:
        for part in outlet.parts:
            if guard is not None and part.port == guard.port:
                values = recorded["sent"][:, first : first + part.size]
                yield float(np.abs(values).max(initial=0.0))
            first += part.size


def _arm_distance(soak: Soak, done: RunDone) -> float:
    """The distance of the arms from each other at the end."""
    assert soak.spec.together is not None
    wanted = [
        m
        for m in declared_metrics.metrics(done.system.scenario)
        if m.name == soak.spec.together.metric
    ]
    results = evaluate(wanted, Run.open(done.outcome.folder))
    return float(results[0].value) if results else float("nan")


def _broken_invariants(soak: Soak, done: RunDone, measures: Mapping[str, float]) -> Iterator[str]:
    """Statements that had to hold, however slow the machine, and did not."""
    yield from done.judged.failures
    yield from _crashes(done)
    yield from _unsent_samples(done)
    yield from _stops(done, of_time=False)
    if not measures["torque"] <= soak.spec.torque_max:
        yield f"a torque of {measures['torque']:.3g} N.m"
    for life, recorded in done.outcome.rows.items():
        if not np.isfinite(recorded["signals"][-1]).all():
            yield f"{life} ended with signals that are not numbers"


def _timed(soak: Soak, done: RunDone, measures: Mapping[str, float]) -> Iterator[str]:
    """Statements that did not hold, which a machine that stands still can cause as well."""
    yield from (f"not in the report: {f.text()}" for f in done.outcome.faults if f.missing)
    if any(isinstance(n, Missed) for n in done.outcome.notes):
        yield from _errors(done)
    yield from _stops(done, of_time=True)
    yield from _separated_arms(soak, done, measures)


def _unsent_samples(done: RunDone) -> Iterator[str]:
    """Samples that were received but not sent, if no fault is a hostile peer."""
    if any(f.kind in HOSTILE for f in done.outcome.faults):
        return
    yield from map(str, done.outcome.replayed.altered if done.outcome.replayed else ())


def _crashes(done: RunDone) -> Iterator[str]:
    """Processes that did not end as commanded, or left no readable files."""
    killed = [e.target for e in done.script.events if e.action == "kill"]
    missed = {n.life for n in done.outcome.notes if isinstance(n, Missed)}
    refused = {n.life for n in done.outcome.notes if isinstance(n, Refused)}
    for process in done.lives:
        life = process.start.life
        errors = done.outcome.folder / NODES / life.file("err")
        said = errors.read_text(encoding="utf-8", errors="replace") if errors.is_file() else ""
        if any(word in said for word in CRASHED):
            yield f"{life} crashed: {said.strip().splitlines()[-1]}"
        elif process.code == -signal.SIGKILL and life.node in killed:
            killed.remove(life.node)
        elif process.code != 0 and life not in missed:
            yield f"{life} ended with exit code {process.code}"
        if life not in done.outcome.rows and life not in missed | refused:
            yield f"{life} has left no journal"
    if not missed:
        yield from _errors(done)


def _errors(done: RunDone) -> Iterator[str]:
    """The sentences of nodes that ended in an error; one that came too late is missed by others."""
    for report in done.outcome.reports:
        if report.statement and report.statement.error:
            yield f"{report.life}: {report.statement.error}"


def _stops(done: RunDone, of_time: bool) -> Iterator[str]:
    """Nodes that stopped for a reason that no fault explains, of time or others."""
    kinds = {f.kind for f in done.outcome.faults}
    explained = frozenset().union(*(STOPS.get(kind, frozenset()) for kind in ("", *kinds)))
    for report in done.outcome.reports:
        last = done.outcome.rows[report.life][-1]
        why = judgement.reasons(done.outcome, report)
        why -= explained
        why = why & OF_TIME if of_time else why - OF_TIME
        if why:
            yield f"{report.life} stopped: {', '.join(sorted(why))}"
        over = last["state"] != LifeState.STOPPING  # else the run has ended in its ramp
        if not of_time and report.end is LifeEnd.FAULT and over and last["scale"] != 0.0:
            yield f"{report.life} stopped, with torque at {last['scale']:.0%}"


def _separated_arms(soak: Soak, done: RunDone, measures: Mapping[str, float]) -> Iterator[str]:
    """Arms that have not synchronized although all nodes are active and had enough time."""
    plan, rows = done.system.plan, done.outcome.rows
    if soak.spec.together is None:
        return
    last = {r.life.node: r for r in done.outcome.reports}
    working = all(r.end is LifeEnd.FINISHED for r in last.values())
    since = [f.t1 for f in done.outcome.faults]
    since += [float(rows[r.life]["slot"][0]) * done.system.nodes[n].h for n, r in last.items()]
    rest = plan.ticks * plan.h - max(since)
    if (
        working
        and rest >= soak.spec.settle
        and not measures.get("together", 0.0) <= soak.spec.together.within
    ):
        yield f"{measures['together']:.3g} apart, {rest:.1f} s after the last fault"
