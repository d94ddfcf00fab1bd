"""One node as a process: configure, wait for the start, tick in C, report.

``python -m bridge.node.start`` is what a rehearsal starts; ``cosim node`` runs the same alone.
Commands come as lines of JSON, ``{"command": "start", "start_ns": …}``, events go out the same way.
What computes and sends is C without the GIL (``bridge/c/wall_clock.c``); Python's threads wait.
"""

from __future__ import annotations

import ctypes as c
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import lcm
from pathlib import Path
from typing import Any

from bridge.can.interface import Attachment
from bridge.deployment.system import System, load_system
from bridge.faults.load import load
from bridge.faults.script import FaultScript, NodeFaults
from bridge.firmware.emulator import image_facts
from bridge.firmware.records import FirmwareError
from bridge.firmware.slots import FAILED
from bridge.native import node as native
from bridge.native.message import COUNTERS, Receiver
from bridge.native.safety import LifeState
from bridge.node import checkpoints, lockstep
from bridge.node.buses import announce, answer, join_run, open_buses
from bridge.node.control import Control, Helpers, Say, listen_to, room_ahead, signals
from bridge.node.fault_injection import inject
from bridge.node.handle import NodeStart, SlotImage
from bridge.node.image import image_slots
from bridge.node.missing_inputs import (
    never_received,
    report_missing_inputs,
    silent_at_end,
    silent_messages,
)
from bridge.node.simulated import is_simulated, run_simulated
from bridge.realtime.host_clock import host_clock
from bridge.realtime.os_grants import Realtime
from bridge.realtime.requests import enter, warm_up, warm_up_warning
from bridge.records.node_lives import Life
from bridge.records.records import LifeEnd, Statement, reason_names
from bridge.wiring.outlets import forwarded_facts
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import monotonic_ns, realtime_ns
from cosim.base.copies import asdict
from cosim.base.errors import CosimError

ENDS = {
    native.FINISHED: LifeEnd.FINISHED,
    native.STOPPED: LifeEnd.STOPPED,
    native.NEVER_STARTED: LifeEnd.NEVER_STARTED,
    native.FAULT: LifeEnd.FAULT,
}


@dataclass(frozen=True, slots=True)
class NodeOptions:
    """Settings of a node's run: `life` names its files, `real`: it may move real drives.

    `boots`: number in its heartbeats, 0: drawn from the time. `warm_up`: duration of the self-test
    before it is ready, s; `script`: faults to inject; `alone`: no supervisor starts it, so it joins
    an active run without a command. `image`: computes the slots. `resumes`: see NodeStart.
    """

    life: Life
    folder: Path
    boots: int = 0
    real: bool = False
    warm_up: float = 0.2
    realtime: bool = True
    script: FaultScript | None = None
    alone: bool = False
    image: SlotImage | None = None
    resumes: int | None = None


def run_node(
    system: System,
    options: NodeOptions,
    say: Say,
    listen: Callable[[Control], None] = lambda control: None,
) -> Statement:
    """Run one node from its configuration to its end, and return its report (also in
    ``LIFE.json``).

    `say` receives events; `listen` is called in a separate thread with the control of the node, and
    passes commands to it. Raises CosimError if the node cannot be configured.
    """
    journal = options.folder / options.life.file("journal")
    if lockstep.is_lockstep(system):
        return _in_lockstep(system, options, journal, say, listen)
    if is_simulated(system):
        return _in_simulated_time(system, options, journal, say, listen)
    with open_buses(system, options.life, options.folder) as buses:
        wired = WiredNode(
            system,
            options.life.node,
            {name: a.bus for name, a in buses.items()},
            journal,
            native.WALL,
            boots=options.boots or realtime_ns() // 10**9 % 4095 + 1,
            real=options.real,
        )
        with wired:
            return _configured(wired, buses, options, say, listen)


def _in_lockstep(
    system: System,
    options: NodeOptions,
    journal: Path,
    say: Say,
    listen: Callable[[Control], None],
) -> Statement:
    """Run a node like :func:`run_node`, without a clock."""
    resumes = options.resumes
    if resumes is not None and resumes >= 0:
        checkpoints.set_aside(options.folder, options.life, system.buses_of(options.life.node))
    with (
        open_buses(system, options.life, options.folder) as buses,
        lockstep.Lockstep(system, options.life.node, buses, journal) as stepping,
    ):
        control = Control(stepping.wired.struct)
        helping = Helpers(control)
        answer(stepping.wired, buses, control)
        steps: Callable[[], int] = stepping.run
        if resumes is not None:
            place = checkpoints.place(options.folder, options.life)
            keeping = checkpoints.NodeCheckpoints(stepping, place, control, say)
            stepping.struct.until_ns, steps = 0, keeping.run
            if resumes >= 0:
                keeping.resume(resumes)
        with signals(control):
            announce(buses)
            say({"event": "ready", "refused": [], "warning": ""})
            helping.start("control", lambda: listen(control))
            result = steps()
            helping.check()
            stalled = stepping.error(result)
            report = node_statement(stepping.wired, buses, options, result, {}, "", None, stalled)
            return _write_report(options, report)


def _in_simulated_time(
    system: System,
    options: NodeOptions,
    journal: Path,
    say: Say,
    listen: Callable[[Control], None],
) -> Statement:
    """Run a node like :func:`run_node`, in the time of simulated buses."""
    with open_buses(system, options.life, options.folder) as buses:
        rings = {name: end.bus for name, end in buses.items()}
        wired = WiredNode(system, options.life.node, rings, journal, native.SIMULATED)
        with wired:
            control = Control(wired.struct)
            helping = Helpers(control)
            with signals(control), image_slots(wired, options.image, options.script, say) as step:
                say({"event": "ready", "refused": [], "warning": ""})
                helping.start("control", lambda: listen(control))
                try:
                    result, failed = run_simulated(wired, buses, step), ""
                except FirmwareError as error:
                    result, failed = FAILED, str(error)
                helping.check()
                report = node_statement(wired, buses, options, result, {}, "", None, failed)
                return _write_report(options, report)


def _configured(
    wired: WiredNode,
    buses: Mapping[str, Attachment],
    options: NodeOptions,
    say: Say,
    listen: Callable[[Control], None],
) -> Statement:
    d, struct = wired.system.deployment, wired.struct
    script, record = options.script, options.folder / options.life.file("faults")
    faults = None if script is None else inject(wired, script, record)
    struct.first = lcm(*(s.period for s in wired.plan.plan.components))
    clock, epoch = host_clock(), struct.epoch
    epoch.host, epoch.kept, epoch.follows = clock.number, clock.kept, options.alone
    epoch.identity[:] = [*clock.identity]
    control = Control(struct)
    helping = Helpers(control)
    answer(wired, buses, control)
    mode = "enforce" if d.enforce else "ask"
    wanted = Realtime(
        mode=mode,  # type: ignore[arg-type]
        priority=wired.spec.priority if options.realtime else 0,
        cpus=() if wired.spec.cpu is None else (wired.spec.cpu,),
    )
    with signals(control), enter(wanted) as granted:
        warm = warm_up(struct.h_ns, options.warm_up) if options.warm_up > 0 else None
        warning = warm_up_warning(warm, wanted.mode) if warm else ""
        refused = [f"{i.name}: {i.said}" for i in granted.refused]

        def ready() -> Mapping[str, Any]:
            announce(buses)
            return {"event": "ready", "refused": refused, "warning": warning}

        helping.start("control", lambda: listen(control))

        def measured() -> bool:
            return options.alone and join_run(wired, buses, control)

        logs = (end.bus.log for end in buses.values())
        journals = [j for j in (wired.journal, wired.heard, *logs) if j is not None]
        with (
            room_ahead(journals, helping),
            report_missing_inputs(wired, say, ready, measured, helping),
        ):
            result = native.functions().node_live(c.byref(struct))
        helping.check()
        facts = granted.facts()
        return _write_report(
            options, node_statement(wired, buses, options, result, facts, warning, faults)
        )


def node_statement(
    wired: WiredNode,
    buses: Mapping[str, Attachment],
    options: NodeOptions,
    result: int,
    granted: Mapping[str, Any],
    warning: str,
    faults: NodeFaults | None,
    stalled: str = "",
) -> Statement:
    """The report of a node at its end; `result`: of node_live."""
    s = wired.struct
    end, error = _end_and_reason(wired, result)
    return Statement(
        life=options.life,
        boots=options.boots,
        end=end,
        error=error or stalled,
        state=LifeState(s.life.state).name.lower(),
        reasons=reason_names(s.life.reasons),
        refused=reason_names(s.refused) if s.refusals else (),
        first_slot=int(s.first),
        slots=int(s.slot - s.first),
        missed=int(s.missed),
        start_ns=int(s.start_ns),
        run=int(s.epoch.run),
        clock=host_clock().describe() if s.clock == native.WALL else "",
        unshared=int(s.epoch.unshared),
        granted=dict(granted),
        warning=warning,
        syncs={"received": int(s.syncs_received), "lost": int(s.syncs_lost)},
        unknown_frames=int(s.unknown) + sum(int(a.bus.struct.foreign) for a in buses.values()),
        messages={name: _counts(r) for name, r in wired.receivers.items()},
        sent={
            o.message: {"frames": int(e.sent), "saturated": int(e.saturated)}
            for o, e in zip(wired.plan.outlets, wired.outlet_bindings.outlets, strict=False)
        },
        services={
            "epochs": int(s.epoch.heard),
            "epochs_sent": int(s.epoch.said),
            "heartbeats_sent": int(s.beats),
            "late_starts": int(s.late_starts),
            "damaged": int(s.damaged),
        },
        heartbeats={name: int(peer.heard) for name, peer in wired.peers.items()},
        forwards={name: forwarded_facts(f) for name, f in wired.forwards.items()},
        guards={name: g.trips() for name, g in wired.guards.items()},
        drives=tuple(wired.commanded.events()),
        lost_drives=tuple(wired.commanded.given_up()),
        drive_faults=sum(int(drive.struct.faults) for drive in wired.drives),
        buses={name: asdict(a.health(monotonic_ns())) for name, a in buses.items()},
        journal_dropped=wired.journal.dropped,
        heard_dropped=wired.heard.dropped if wired.heard else 0,
        injected=faults.hits() if faults else {},
        firmware=image_facts(Path(options.image.path)) if options.image else {},
    )


def _end_and_reason(wired: WiredNode, result: int) -> tuple[LifeEnd, str]:
    """The end of a life, and what went wrong in a sentence."""
    s = wired.struct
    if result > 0:
        end = wired.engine.end(result)
        if end is not None:
            return LifeEnd.ENDED, str(end)
        return LifeEnd.FAILED, str(wired.engine.failure(result))
    if result == native.FINISHED and s.first >= s.slots:
        return LifeEnd.TOO_LATE, (
            f"the run was over: {s.slots} slots to t = {s.slots * s.h:g} s, and this life would "
            f"have begun with slot {s.first}"
        )
    if result == native.NOT_JOINED:
        return LifeEnd.FAILED, f"it could not join the run: {wired.failed}"
    if result == native.FINISHED and (unheard := never_received(wired)):
        return LifeEnd.DEAF, f"heard nothing of {', '.join(unheard)} in {s.slots - s.first} slots"
    if result == native.FINISHED and (unheard := silent_at_end(wired)):
        return LifeEnd.DEAF, f"at its end it had received nothing more of {', '.join(unheard)}"
    lost = silent_messages(wired) if result != native.FINISHED else []
    return ENDS.get(
        result, LifeEnd.FAILED
    ), f"receives nothing from {', '.join(lost)}" if lost else ""


def _write_report(options: NodeOptions, report: Statement) -> Statement:
    """The report, written: while signals are still ours, so that a Ctrl-C does not take it."""
    report.write(options.folder)
    return report


def _counts(receiver: Receiver) -> dict[str, int]:
    return {name: int(getattr(receiver, name)) for name in COUNTERS}


# ---- as a process ---------------------------------------------------------------------------


def run_started(
    start: NodeStart, say: Say, listen: Callable[[Control], None], system: System | None = None
) -> Statement:
    """Like :func:`run_node`, with the settings of a supervisor; `system`: if it was read already.

    Raises CosimError.
    """
    if system is None:
        system = load_system(start.scenario, str(start.deployment), start.settings)
    options = NodeOptions(
        life=start.life,
        folder=start.folder.absolute(),  # an FMU may change the working directory
        boots=start.life.boot,
        warm_up=start.warm_up,
        realtime=start.realtime,
        real=start.real,
        script=load(Path(start.script)) if start.script else None,
        image=start.image,
        resumes=start.resumes,
    )
    return run_node(system, options, say, listen)


def done(report: Statement) -> Mapping[str, Any]:
    """The last event of a life: how it ended."""
    slot = report.first_slot + report.slots
    facts = {"end": report.end, "state": report.state, "error": report.error, "slot": slot}
    return {"event": "done", **facts}


def main(arguments: Sequence[str]) -> int:
    """The process a rehearsal starts: one argument, JSON. Returns the exit code."""
    stdout = sys.stdout

    def say(event: Mapping[str, Any]) -> None:
        with suppress(BrokenPipeError):  # whoever started this node is gone; it stops by itself
            stdout.write(json.dumps(event) + "\n")
            stdout.flush()

    try:
        report = run_started(NodeStart.parse(arguments[0]), say, listen_to(sys.stdin))
    except CosimError as error:
        say({"event": "failed", "error": str(error), "exit_code": error.exit_code})
        return error.exit_code
    say(done(report))
    return 0
