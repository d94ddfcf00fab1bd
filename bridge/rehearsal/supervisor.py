"""A rehearsal: one process per node on the wall clock, started together, monitored, and collected.

All results are in the run folder in every case: journals survive the end of the process that
writes them, and a killed node is a line of the report.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import final

from bridge.bus_server.lag import BusLag
from bridge.deployment.system import System, load_system
from bridge.node.drive_enable import disabled_at_the_end, foreign_drives
from bridge.node.handle import NodeHandle, NodeStart, missing_text
from bridge.node.lockstep import is_lockstep
from bridge.node.process import Process
from bridge.node.simulated import is_simulated
from bridge.node.thread import Thread
from bridge.records.node_lives import Life
from bridge.records.records import (
    Deaf,
    Done,
    Gone,
    Lagged,
    LifeEnd,
    Missed,
    Refused,
    Remark,
    record_note,
)
from bridge.rehearsal import checkpoints
from bridge.rehearsal.checkpoints import RunCheckpoints
from bridge.rehearsal.outside import OutsideNodes
from bridge.rehearsal.settings import RehearsalRecord as RehearsalRecord
from bridge.rehearsal.settings import ScheduledEvent
from bridge.rehearsal.settings import Settings as Settings
from bridge.rehearsal.simulated_buses import served
from cosim.base.clock import monotonic_ns, realtime_offset_ns, sleep
from cosim.base.copies import replace
from cosim.base.errors import Interrupted, RunError
from cosim.base.files import write_file
from cosim.base.interrupts import acknowledge, signals_as_interrupt
from cosim.record.folder import NODES

#: A file in a run folder.
STARTED = "rehearsal.json"  # for who looks on: what runs, and since when
IN_PROCESS = "virtual"
#: s between two looks at the nodes.
LOOK = 0.05
#: s; an event that comes later than that puts off those after it.
LATE = 0.1
#: s after the end; Zenoh stands by a connection that nobody answers any more for 10 s.
ENDING = 30.0
#: s from the last node's being ready to t = 0.
LEAD = 0.5


@final
class Rehearsal:
    """The processes of a rehearsal. Use as a context manager: nothing is left running."""

    def __init__(self, system: System, settings: Settings, folder: Path) -> None:
        self.system, self.settings, self.folder = system, settings, folder
        self.ended = RehearsalRecord()
        self.current: dict[str, NodeHandle] = {}
        self.expected: set[str] = set()  # nodes whose end is part of the plan
        self._stopped = False  # all were told to stop
        self._over = False
        self._lost: list[NodeHandle] = []  # nodes that gave up a drive in the run
        buses = system.deployment.buses.values()
        alone = any(b.kind == "can" and b.interface == IN_PROCESS for b in buses)
        # without the wall clock nothing says when the end is
        self._timed = not (is_lockstep(system) or is_simulated(system))
        self._checkpoints: RunCheckpoints | None = None
        if settings.keeping is not None:
            longest = max(plan.h for plan in system.nodes.values())
            self._checkpoints = RunCheckpoints(settings.keeping, round(longest * 1e9))
        self._lags: list[BusLag] = []
        self._addresses: tuple[str, ...] = ()  # of buses that this process serves, as settings
        self._outside: OutsideNodes | None = None
        self._kind: type[Process] | type[Thread] = Thread if alone else Process
        self._stack, self._drives = ExitStack(), ExitStack()
        (folder / NODES).mkdir(parents=True, exist_ok=True)

    def __enter__(self) -> Rehearsal:
        self._addresses = self._stack.enter_context(served(self.system, self._lags))
        if self.settings.starter is not None:
            self._stack.enter_context(self.settings.starter)
        return self

    def _start_outside(self) -> None:
        """Start the programs of nodes that are not this project's."""
        s = self.settings
        if s.outside:
            changes = [*s.changes, *self._addresses]
            system = load_system(s.scenario, str(s.deployment), changes)
            outside = OutsideNodes(system, s.outside, self.folder / NODES)
            self._outside = self._stack.enter_context(outside)

    def __exit__(self, *_: object) -> None:
        self.end()

    def closing(self, do: Callable[[], None]) -> None:
        """Do this when the rehearsal is left, whatever happens."""
        self._stack.callback(do)

    def start_node(self, name: str) -> NodeHandle:
        """Start a node's process, of its next life."""
        life = Life(name, 1 + sum(p.start.life.node == name for p in self.ended.lives))
        s = self.settings
        start = NodeStart(
            s.scenario,
            s.deployment,
            (*s.changes, *self._addresses),
            life,
            self.folder / NODES,
            warm_up=s.warm_up if life.boot == 1 else 0.0,
            realtime=s.realtime,
            real=s.real,
            script=s.script,
            image=s.images.get(name),
            resumes=None if s.keeping is None else s.keeping.resumes,
        )
        process: NodeHandle
        if s.starter is not None:
            process = s.starter.start_node(start)
        else:
            with s.on_host(name):
                process = self._kind(start)
        self._stack.callback(process.end)
        self.ended.lives.append(process)
        self.current[name] = process
        return process

    # ---- the run -----------------------------------------------------------------------------

    def run(
        self, progress: Callable[[float, float], None] = lambda t, end: None
    ) -> RehearsalRecord:
        """Start all nodes, wait for their end, and return what came of it.

        `progress` is called with (t, end), s. Raises RunError where a node cannot be configured or
        ends on its own; Ctrl-C and SIGTERM stop all nodes safely and become Interrupted.
        """
        for name in self.settings.nodes or tuple(self.system.nodes):
            if name not in self.settings.outside:
                self.start_node(name)
        self._start_outside()
        prepared = [e.prepare(self) for e in self.settings.events if e.prepare is not None]
        self._all_ready()
        for wait in prepared:
            wait()
        self._say(f"ready: {', '.join(self.current)}")
        self._arm()
        self._say(f"torques act in {LEAD:g} s, as far as the guards let them")
        self.ended.start_ns = monotonic_ns() + round(LEAD * 1e9)
        self._announce()
        for process in self.current.values():
            process.send_command("start", start_ns=self.ended.start_ns)
        if self._outside:
            self._outside.start(self.ended.start_ns)
        try:
            with signals_as_interrupt():
                self._watch(progress)
        except KeyboardInterrupt:
            acknowledge()
            if self._checkpoints is not None:
                self._checkpoints.save_last(self.current)
            self.stop()
            self.ended.interrupted = True
            raise Interrupted(self.t, str(self.folder)) from None
        return self.ended

    def end(self) -> None:
        """End all processes, none after the other; their journals are complete then.

        Drives are disabled behind the last torque of their nodes, which some of them would take for
        a request to be enabled.
        """
        for process in self.ended.lives:
            process.send_command("quit")
        with self._drives:
            self._stack.close()
        if not self._over:
            self._over = True
            self.ended.notes += self._lagged()
            ends = (f"{n} {p.done['end'] if p.done else 'killed'}" for n, p in self.current.items())
            self._say(f"no torque any more, drives were disabled: {', '.join(ends)}")

    def _lagged(self) -> Iterator[Lagged]:
        """A note for each time that a bus served here was late during the run."""
        for lag in self._lags:
            t, end = ((ns - self.ended.start_ns) * 1e-9 for ns in (lag.begin_ns, lag.end_ns))
            if self.ended.start_ns and end > 0 and t < self.length:
                yield Lagged(t=max(t, 0.0), bus=lag.bus, end=end, late=lag.lag_ns * 1e-9)

    def _say(self, text: str) -> None:
        """Say a step of a run with real drives."""
        if self.settings.real and self.current:
            self.settings.say(text)

    @property
    def t(self) -> float:
        """Time of the run, s."""
        return (monotonic_ns() - self.ended.start_ns) * 1e-9

    @property
    def length(self) -> float:
        """The length of the run, s."""
        return self.system.plan.ticks * self.system.plan.h

    def _announce(self) -> None:
        facts = {
            "scenario": str(self.settings.scenario.resolve()),
            "deployment": str(self.settings.deployment.resolve()),
            "settings": list(self.settings.changes),
            "pid": os.getpid(),
            "nodes": {name: process.pid for name, process in self.current.items()},
            "start_ns": self.ended.start_ns,
            "wall_ns": self.ended.start_ns + realtime_offset_ns(),
        }
        write_file(self.folder / STARTED, f"{json.dumps(facts, indent=2)}\n".encode())

    def _arm(self) -> None:
        """Arm the nodes that command drives, all with real ones, and wait until these are ready.

        Raises RunError with the drive, the expected and the told state if one does not follow.
        """
        real, commanding = self.settings.real, []
        if self._timed:
            commanding = [n for n in self.current if foreign_drives(self.system, (n,))]
        if real:
            sleep(LEAD)  # heartbeats and first positions have been heard
            self._drives.enter_context(disabled_at_the_end(self.system, self.current))
        self._say("drives are cleared and enabled, and get torque 0")
        for name in self.current if real else commanding:
            self.current[name].send_command("arm")
        patience = self.system.deployment.patience  # a bring-up ends sooner, by its own times
        end = monotonic_ns() + round(patience * 1e9)
        waiting = list(commanding)
        while waiting:
            for name in list(waiting):
                process = self.current[name]
                process.check()
                self._refused(process)
                if process.drives:
                    self.stop()
                    raise RunError(f"node {process.start.life}: {'; '.join(process.drives)}")
                if process.drives is not None:
                    waiting.remove(name)
                    self._say(f"{name}: all drives are enabled")
            if monotonic_ns() > end:
                self.stop()
                raise RunError(
                    f"drives of {', '.join(waiting)} are not ready {patience:g} s after ARM "
                    "(patience): not all have told a position"
                )
            sleep(LOOK)

    def _all_ready(self) -> None:
        patience = self.system.deployment.patience
        end = monotonic_ns() + round(patience * 1e9)
        waiting = dict(self.current)
        outside = list(self.settings.outside)
        while waiting or outside:
            for name, process in list(waiting.items()):
                process.check()
                if process.ready:
                    del waiting[name]
            outside = self._outside.waiting() if self._outside else []
            if monotonic_ns() > end:
                said = "; ".join(
                    [f"{n}: {missing_text(p.waiting)}" for n, p in waiting.items()]
                    + [f"{n}, outside: is not heard to wait for its start" for n in outside]
                )
                raise RunError(f"not ready after {patience:g} s (patience): {said}")
            sleep(LOOK)

    def _watch(self, progress: Callable[[float, float], None]) -> None:
        length = self.length
        events = sorted(self.settings.events, key=lambda e: e.t)
        while any(p.code is None for p in self.current.values()) or _will_restart(events, length):
            while events and events[0].t <= self.t:
                event = events.pop(0)
                begun = self.t
                event.action(self)
                done = self.t if event.sets_interface else begun
                self.ended.notes.append(record_note(event.what, done))
                late = self.t - event.t
                if late > LATE:  # what is to last keeps its length
                    events = [replace(e, t=e.t + late) for e in events]
            self._look()
            if self._checkpoints is not None:
                self._checkpoints.look(self.current)
            t = self.t if self._checkpoints is None else self._checkpoints.t
            progress(min(max(t, 0.0), length), length)
            if self._timed and self.t > length + ENDING and not self._end_late_lives():
                raise RunError(f"nodes still run {self.t - length:.0f} s after the end; stopped")
            next_ = events[0].t - self.t if events else LOOK
            look = LOOK if self._checkpoints is None else checkpoints.LOOK
            sleep(min(look, max(next_, 0.001)))
        self._look()

    def _look(self) -> None:
        """Detect nodes that have ended; an unplanned end stops the others."""
        for name, how in self._outside.ended() if self._outside and self.t < self.length else ():
            self.ended.notes.append(Remark(t=self.t, remark=f"node {name}, outside: {how}"))
        for name, process in list(self.current.items()):
            process.poll()
            while process.faults:  # of its emulator, at the time of the run
                said = process.faults.pop(0)
                self.ended.notes.append(
                    Done(**{k: said[k] for k in ("t", "action", "target", "index")})
                )
            self._refused(process)
            self._stop_without_input(process)
            if process.drives and process not in self._lost:
                self._lost.append(process)
                self._say(f"{name} stops: {'; '.join(process.drives)}")
            if process.code is None or name in self.expected:
                continue
            end = LifeEnd(process.done["end"]) if process.done else LifeEnd.KILLED
            if end in (LifeEnd.FINISHED, LifeEnd.FAULT):
                continue
            self.expected.add(name)
            life, why = process.start.life, process.done["error"] if process.done else ""
            detail = why or (end if process.done else process.reason())
            # Whoever was to join and could not before the end, because nobody was there any more.
            late = life.boot > 1 and not process.done and not process.ready and self.t > self.length
            if end is LifeEnd.TOO_LATE or late:
                self.ended.notes.append(Missed(t=self.t, life=life, detail=detail))
                continue
            gone = Gone(
                t=self._time_of(process), life=life, end=end, code=process.code, detail=detail
            )
            self.ended.notes.append(gone)
            self._stop_others(process)

    def _time_of(self, process: NodeHandle) -> float:
        """Time of the run at which a node has ended, s; without the wall clock, of its slot."""
        if self._timed or not process.done:
            return self.t
        return float(process.done["slot"]) * self.system.nodes[process.start.life.node].h

    def _stop_without_input(self, process: NodeHandle) -> None:
        """Stop the run if a node no longer receives a required input."""
        if not process.deaf or self._stopped:
            return
        note = Deaf(t=self.t, life=process.start.life, to=process.deaf)
        self.ended.notes.append(note)
        process.send_command("stop")
        self.expected.add(process.start.life.node)
        self._stop_others(process)

    def _stop_others(self, process: NodeHandle) -> None:
        self._stopped = True
        for other in self.current.values():
            if other is not process:
                life = other.start.life
                if life.boot > 1 and not other.ready and other.code is None:
                    detail = missing_text(other.waiting)
                    self.ended.notes.append(Missed(t=self.t, life=life, detail=detail))
                self.expected.add(life.node)
                other.send_command("stop")

    def _end_late_lives(self) -> bool:
        """End restarted lives that are not ready long after the end of the run."""
        running = [p for p in self.current.values() if p.code is None]
        missed = [p for p in running if not p.ready and p.start.life.boot > 1]
        for process in missed:
            self.ended.notes.append(Missed(t=self.t, life=process.start.life))
            self.expected.add(process.start.life.node)
            process.send_signal(signal.SIGKILL)
            process.wait(1.0)
        return missed == running

    def _refused(self, process: NodeHandle) -> None:
        """A node that refuses to start ends the run; one that was to rejoin stays away."""
        if not process.refused:
            return
        said, life = process.refused.pop(), process.start.life
        why, missing = tuple(said["reasons"]), tuple(said["missing"])
        note = Refused(t=self.t, life=life, reasons=why, armed=said["armed"], missing=missing)
        if life.boot == 1:
            self.stop()
            raise RunError(note.describe())
        self.ended.notes.append(note)
        self.expected.add(process.start.life.node)
        process.send_command("quit")

    def stop(self) -> None:
        """Safe stop of all nodes, and wait for it."""
        if self._outside:
            self._outside.stop()
        for process in self.current.values():
            process.send_command("stop")
        for process in self.current.values():
            process.wait(3.0)

    # ---- what a script may do to it ----------------------------------------------------------

    def kill(self, name: str) -> None:
        """SIGKILL, which is part of the plan."""
        self.expected.add(name)
        self.current[name].send_signal(signal.SIGKILL)

    def freeze(self, name: str) -> None:
        """SIGSTOP."""
        self.current[name].send_signal(signal.SIGSTOP)

    def thaw(self, name: str) -> None:
        """SIGCONT."""
        self.current[name].send_signal(signal.SIGCONT)

    def restart(self, name: str) -> None:
        """A new life of a node that has ended, which joins the run."""
        self.expected.discard(name)
        process = self.start_node(name)
        process.send_command("start", start_ns=self.ended.start_ns)


def _will_restart(events: Sequence[ScheduledEvent], length: float) -> bool:
    """True if a node is still to be started, in time."""
    return any(e.restarts_node and e.t < length for e in events)
