"""One run of a soak: real nodes, faults drawn from a seed, and whether all was as it has to be.

Plain data goes in and comes out; it runs in a process of its own (:mod:`cosim.sweep.workers`).
"""

from __future__ import annotations

import shutil
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bridge import evidence_links, happen, judge
from bridge.campaign import RunSpec
from bridge.fault_script import HOSTILE, FaultScript
from bridge.faults import build
from bridge.hosts import Hosts, groups, settings
from bridge.judge import Judged
from bridge.lives import Life
from bridge.outcome import Outcome, complete
from bridge.records import End, Missed, Refused
from bridge.rehearse import NODES, Node, Rehearsal, Settings
from bridge.soak_spec import Soak, Table, draw, text
from bridge.system import System, load_system
from bridge.verdict import OF_TIME, Verdict, Word, limit, unasked_lateness
from bridge.wiring import Rows
from cosim.analysis import declared
from cosim.analysis.metrics import evaluate
from cosim.clock import stopwatch
from cosim.errors import CosimError
from cosim.failures import sentence
from cosim.interrupts import terminated
from cosim.record import Run
from cosim.sweep.perform import Row

RUNS, SCRIPT = "runs", "script.toml"
#: What a node may stop for, by the kind of fault that explains it; of "": any.
STOPS: Mapping[str, frozenset[str]] = {
    "": frozenset({"stale", "watchdog", "peer", "sync", "jump"}),
    "freeze": frozenset({"overrun"}),
    "clock-jump": frozenset({"overrun"}),
    "restart": frozenset({"apart"}),
    **dict.fromkeys(HOSTILE, frozenset({"guard", "component"})),
}
#: What a process says on standard error when it has crashed.
CRASHED = ("Traceback (most recent", "panicked at", "Fatal Python error", "Segmentation fault")


@dataclass(frozen=True, slots=True)
class Job:
    """What all runs of a soak have in common; `changes`: of scenario and deployment.

    `hosted`: each run in network namespaces of its own, `network`: with faults of the network
    between them. `keep`: run folders also of runs in which all was well.
    """

    scenario: Path
    deployment: Path
    changes: tuple[str, ...]
    soak: Soak
    folder: Path
    seed: int
    hosted: bool
    network: bool
    realtime: bool = True
    keep: bool = False


@dataclass(frozen=True, slots=True)
class RunDone:
    """A run that came to its end, with all there is to judge it by."""

    system: System
    script: FaultScript
    outcome: Outcome
    judged: Judged
    lives: Sequence[Node]


#: What a run's faults are drawn by: from the system and the links between its hosts.
Drawn = Callable[[System, tuple[str, ...]], Table]


def perform(job: Job, k: int) -> Row:
    """Run `k`; what goes wrong becomes the reason of its row."""

    def drawn(system: System, links: tuple[str, ...]) -> Table:
        return draw(job.soak, system, links, job.seed, k)

    return performed(job, k, lambda folder: rehearsed(job, k, folder, drawn))


def performed(job: Job, k: int, run: Callable[[Path], RunDone]) -> Row:
    """Judge what `run` makes in the folder of run `k`; what goes wrong becomes its row's reason."""
    name, watch = f"{k:05d}", stopwatch()
    folder = job.folder / RUNS / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    cells: dict[str, Any] = {"faults": "", "zenoh": Path(job.soak.zenoh(job.seed, k)).stem}
    measures: dict[str, float] = {}
    try:
        with terminated(), np.errstate(all="ignore"):
            done = run(folder)
            measures = _measures(job, done)
            found = judged(job, done, measures)
        cells["faults"] = ", ".join(f.kind for f in done.outcome.faults)
        cells["ended"] = "; ".join(f"{x}: {why}" for x, why in done.judged.ended.items())
    except CosimError as error:
        found = Verdict(Word.ERROR, (f"no run: {error}",))
    except Exception as error:
        found = Verdict(Word.ERROR, (f"no verdict: {sentence(error)}",))
    cells["verdict"] = str(found.word)
    well = found.word is Word.PASSED
    if well and not job.keep:
        shutil.rmtree(folder, ignore_errors=True)
    return Row(
        name, cells, job.changes, well, "; ".join(found.reasons), wall=watch(), measures=measures
    )


def judged(job: Job, done: RunDone, measures: Mapping[str, float]) -> Verdict:
    """The verdict on a run of a soak; inconclusive where only the machine's lateness shows."""
    found, timed = list(_always(job, done, measures)), list(_timed(job, done, measures))
    if found:
        return Verdict(Word.FAILED, (*found, *timed))
    late = unasked_lateness(done.system, done.outcome)
    if timed and late >= limit(done.system) / 2:
        why = f"this machine let a node wait for {late * 1e3:.0f} ms"
        return Verdict(Word.INCONCLUSIVE, (why, *timed))
    return Verdict(Word.FAILED if timed else Word.PASSED, tuple(timed))


def rehearsed(job: Job, k: int, folder: Path, drawn: Drawn) -> RunDone:
    """Rehearse with what is drawn for this run, and make its folder."""
    system = load_system(job.scenario, str(job.deployment), job.changes)
    with ExitStack() as stack:
        changes, hosts = job.changes, None
        if job.hosted:
            parts = groups(system) if job.network else {next(iter(system.nodes)): [*system.nodes]}
            hosts = Hosts(parts, folder / "packets", job.seed * 100_003 + k)
            if hosts.network is not None:
                zenoh = job.soak.zenoh(job.seed, k)
                changes += tuple(settings(system, parts, hosts.addresses, zenoh))
            stack.enter_context(hosts)
            system = load_system(job.scenario, str(job.deployment), changes)
        script = script_of(drawn(system, _links(hosts)), folder)
        return _rehearsed(job, system, changes, script, folder, hosts)


def _links(hosts: Hosts | None) -> tuple[str, ...]:
    network = hosts.network if hosts else None
    return tuple(network.names) if network else ()


def script_of(document: Table, folder: Path) -> FaultScript:
    """The script of a run, written into its folder, too."""
    (folder / SCRIPT).write_text(text(document), encoding="utf-8")
    return build(document, folder / SCRIPT)


def _rehearsed(
    job: Job,
    system: System,
    changes: tuple[str, ...],
    script: FaultScript,
    folder: Path,
    hosts: Hosts | None,
) -> RunDone:
    network = hosts.network if hosts else None
    given = Settings(
        job.scenario, job.deployment, changes, warm_up=0.0, realtime=job.realtime,
        script=str(script.path), events=happen.events(script, system, network),
    )  # fmt: skip
    if hosts is not None:
        given = replace(given, inside=hosts.inside)
    facts = {"settings": list(changes), "faults": str(script.path), "real": False}
    with Rehearsal(system, given, folder) as rehearsal:
        rehearsal.run()
        rehearsal.end()
        ended = rehearsal.ended
        there = network and evidence_links.Network(network, hosts.hosts, ended.start_ns)  # type: ignore[union-attr]
        outcome = complete(
            system, folder, ended, facts, with_twin=False, formats=(), script=script, network=there
        )
    spec = RunSpec(script=str(script.path))
    return RunDone(system, script, outcome, judge.judge(system, spec, outcome), ended.lives)


# ---- what came of it ------------------------------------------------------------------------


def _measures(job: Job, done: RunDone) -> dict[str, float]:
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
        "stopped": float(sum(r.end is End.FAULT for r in reports)),
    }
    if job.soak.spec.together is not None:
        found["together"] = _together(job, done)
    return found


def torque(system: System, rows: Mapping[Life, Rows]) -> float:
    """The greatest torque that went on, N.m: what a guard let through, or else what was computed.

    NaN if one was not a number.
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


def _together(job: Job, done: RunDone) -> float:
    """How far the arms are from each other at the end."""
    assert job.soak.spec.together is not None
    wanted = [
        m for m in declared.metrics(done.system.scenario) if m.name == job.soak.spec.together.metric
    ]
    results = evaluate(wanted, Run.open(done.outcome.folder))
    return float(results[0].value) if results else float("nan")


def _always(job: Job, done: RunDone, measures: Mapping[str, float]) -> Iterator[str]:
    """What had to be otherwise, however slow the machine."""
    yield from done.judged.failures
    yield from _crashes(done)
    yield from _strangers(done)
    yield from _stops(done, of_time=False)
    if not measures["torque"] <= job.soak.torque_max:
        yield f"a torque of {measures['torque']:.3g} N.m"
    for life, recorded in done.outcome.rows.items():
        if not np.isfinite(recorded["signals"][-1]).all():
            yield f"{life} ended with signals that are not numbers"


def _timed(job: Job, done: RunDone, measures: Mapping[str, float]) -> Iterator[str]:
    """What had to be otherwise, but a machine that stands still can cause as well."""
    yield from (f"not in the report: {f.text()}" for f in done.outcome.faults if f.missing)
    yield from _stops(done, of_time=True)
    yield from _ways_apart(job, done, measures)


def _strangers(done: RunDone) -> Iterator[str]:
    """Samples that were heard and not sent, where no fault is a hostile peer."""
    if any(f.kind in HOSTILE for f in done.outcome.faults):
        return
    yield from map(str, done.outcome.replayed.altered if done.outcome.replayed else ())


def _crashes(done: RunDone) -> Iterator[str]:
    """Processes that did not end as they were told, or left nothing to read."""
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
    for report in done.outcome.reports:
        if report.said and report.said.error:
            yield f"{report.life}: {report.said.error}"


def _stops(done: RunDone, of_time: bool) -> Iterator[str]:
    """Nodes that stopped for a reason that no fault explains, of time or others."""
    kinds = {f.kind for f in done.outcome.faults}
    explained = frozenset().union(*(STOPS.get(kind, frozenset()) for kind in ("", *kinds)))
    for report in done.outcome.reports:
        last = done.outcome.rows[report.life][-1]
        why = judge.reasons(done.outcome, report)
        why -= explained
        why = why & OF_TIME if of_time else why - OF_TIME
        if why:
            yield f"{report.life} stopped: {', '.join(sorted(why))}"
        if not of_time and report.end is End.FAULT and last["scale"] != 0.0:
            yield f"{report.life} stopped, with torque at {last['scale']:.0%}"


def _ways_apart(job: Job, done: RunDone, measures: Mapping[str, float]) -> Iterator[str]:
    """Arms that are not together although everybody works and had the time."""
    plan, rows = done.system.plan, done.outcome.rows
    if job.soak.spec.together is None:
        return
    last = {r.life.node: r for r in done.outcome.reports}
    working = all(r.end is End.FINISHED for r in last.values())
    since = [f.t1 for f in done.outcome.faults]
    since += [float(rows[r.life]["slot"][0]) * done.system.nodes[n].h for n, r in last.items()]
    rest = plan.ticks * plan.h - max(since)
    if working and rest >= job.soak.settle and not measures.get("together", 0.0) <= job.soak.within:
        yield f"{measures['together']:.3g} apart, {rest:.1f} s after the last fault"
