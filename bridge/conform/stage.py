"""A participant with everything around it: buses, peers, supervisor, and what it has sent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import final

import numpy as np

from bridge.conform.cast import Cast, EpochFields, MessageRole, PeerRole, SyncRole
from bridge.conform.hearing import Heard, HeardFrame, Hearing
from bridge.conform.lateness import KitLateness
from bridge.conform.lines import BusLine, CanLine
from bridge.conform.program import Program
from bridge.deployment import ranges
from bridge.deployment.cut import start_values
from bridge.deployment.protection import drives_by, emulated
from bridge.deployment.spec import StaleSpec
from bridge.deployment.system import System
from bridge.native.enums import NMT_ARM, NMT_RESET, NMT_START, LifeState, Why
from bridge.native.frame import Frame
from bridge.node.buses import can_spec
from bridge.safety.limits import to_si
from cosim.base.clock import monotonic_ns, sleep
from cosim.base.errors import CosimError
from cosim.scenario.assemble import assemble

#: s: a participant may take so long to obey a command.
OBEYS = 1.5
#: s from an EPOCH to its t = 0.
LEAD = 0.5
#: s: a rule about silence takes at most so long.
LONGEST = 2.5
#: s between two starts of a program, which may count its lives by the seconds of the date.
APART = 1.1
#: The number added to the start of each value, in its unit.
NUDGE = 0.1


class UnreadyError(CosimError):
    """The participant did not come into the state that a rule begins with."""


@dataclass(frozen=True, slots=True)
class Watched:
    """A message whose absence stops the participant after `timeout` (s), for the reason `why`."""

    message: str
    timeout: float
    why: Why


@final
class ParticipantStage:
    """The participant `node` of a deployment, and the kit around it. Use as a context manager."""

    def __init__(self, system: System, node: str, command: Sequence[str]) -> None:
        self.system, self.node = system, node
        self.spec, self.plan = system.deployment.nodes[node], system.nodes[node]
        self.buses = system.buses_of(node)
        self.number = self.spec.number
        self.lateness = KitLateness()
        self.hearing = Hearing(system, node)
        self.program = Program(command)
        self.lines: dict[str, BusLine] = {}
        services = {bus: system.services[bus] for bus in self.buses}
        self.cast = Cast(system, node, services, self._send, self.lateness)
        self._fill_cast()
        self.runs: list[tuple[int, int]] = []
        """The number of the first frame after each start, and its t = 0 (monotonic, ns)."""
        self.lives: list[int] = []
        """The number of the first frame of each life."""
        self.fresh = False
        """True until the first START of a life."""
        self.stopped = False
        """True from a STOP of a rule to the next life."""
        self._began_ns = 0
        self.dead = ""
        """The reason why no participant could be started."""

    def _send(self, bus: str, frame: Frame) -> None:
        self.lines[bus].send(frame)

    # ---- what the deployment says ------------------------------------------------------------

    def seconds(self, key: str) -> float:
        """A time of the node (ramp, within, heartbeat, overrun, phase), in s."""
        return self.system.deployment.seconds(getattr(self.spec, key), "nodes", self.node, key)

    @property
    def slot(self) -> float:
        """The length of a slot, s."""
        return self.plan.h

    @property
    def run_end(self) -> float:
        """The length of the run, s."""
        return self.plan.slots * self.plan.h

    @property
    def bears(self) -> float:
        """The lateness of the kit with which a verdict still counts, s: half of the shortest
        time-out of the participant, and at least 20 ms.
        """
        times = [self.seconds("within") if self.spec.requires else 1.0]
        times += [w.timeout for w in self.watched()]
        return max(0.02, min(times) / 2)

    def late(self, since_ns: int) -> float:
        """The lateness of the kit since then that a tolerance counts, s: at most `bears`, with more
        of it no attempt counts.
        """
        return min(self.lateness.worst_ns(since_ns) * 1e-9, self.bears)

    def watched(self) -> list[Watched]:
        """Messages whose absence the participant has to notice within `LONGEST`."""
        found = [w for name in self.system.received_by(self.node) for w in self._timeouts(name)]
        return sorted((w for w in found if 0 < w.timeout <= LONGEST), key=lambda w: w.timeout)

    def _timeouts(self, message: str) -> Iterator[Watched]:
        d, carried = self.system.deployment, self.system.messages[message]
        if drives_by(self.plan, self.spec, message) and self.spec.drive is not None:
            place = d.place("nodes", self.node, "drive.watchdog")
            watchdog = emulated(self.spec.drive, d).watchdog or 0.0
            yield Watched(message, to_si(watchdog, "s", place), Why.WATCHDOG)
        usual = max(d.silence, 3 * carried.period_ns * 1e-9) if d.silence > 0 else 0.0
        stops = []
        for inlet in self.plan.inlets:
            if inlet.message == message:
                name = f"{inlet.component}.{inlet.target.port}"
                stop = self.spec.stale.get(name, StaleSpec()).stop
                said = None if stop is None else d.seconds(stop, "nodes", self.node, "stale", name)
                stops.append(usual if said is None else said)
        if any(stops):
            yield Watched(message, min(s for s in stops if s), Why.STALE)

    # ---- the cast ----------------------------------------------------------------------------

    def _fill_cast(self) -> None:
        d = self.system.deployment
        for peer in d.nodes:
            buses = tuple(b for b in self.buses if b in self.system.buses_of(peer))
            if peer == self.node or not buses:
                continue
            beat = d.seconds(d.nodes[peer].heartbeat, "nodes", peer, "heartbeat") or 0.05
            self.cast.peers[peer] = PeerRole(
                peer, d.nodes[peer].number, round(beat * 1e9), buses, boots=17
            )
        values = self._values()
        for name in self.system.received_by(self.node):
            self.cast.messages[name] = MessageRole(self.system.messages[name], values[name])
        syncing = [b for b in self.buses if self.system.services[b].sync is not None]
        if d.sync and d.sync != self.node and syncing:
            period = self.system.sync_ticks * self.system.plan.h
            self.cast.sync = SyncRole(tuple(syncing), round(period * 1e9))

    def _values(self) -> Mapping[str, np.ndarray]:
        """The values of each received message: those at the start of the scenario and `NUDGE`, so
        that a velocity or a torque is not 0; within their range.
        """
        plan = assemble(self.system.scenario)
        start, slots = start_values(plan), plan.slots()
        found = {}
        for name in self.system.received_by(self.node):
            carried = self.system.messages[name]
            values = []
            for v in ranges.values(carried):
                slot = slots[v.name]
                values.append(float(start[slot.start + v.entry]) + NUDGE)
            limits = ranges.limits(self.system, self.node, carried)
            low, high = [x.low for x in limits], [x.high for x in limits]
            found[name] = np.clip(np.array(values), low, high)
        return found

    # ---- opening and closing -----------------------------------------------------------------

    @contextmanager
    def open(self) -> Iterator[ParticipantStage]:
        """Join the buses, begin to play. Raises BusError, ScenarioError."""
        with ExitStack() as stack:
            stack.callback(self.lateness.close)
            for bus in self.buses:
                self.lines[bus] = self._line(bus)
                stack.callback(self.lines[bus].close)
            self.cast.open()
            stack.callback(self.cast.close)
            stack.callback(self.program.close)
            yield self

    def _line(self, bus: str) -> BusLine:
        def arrived(frame: Frame, t_ns: int) -> None:
            self.hearing.arrived(bus, frame, t_ns)

        if self.system.deployment.buses[bus].kind == "zenoh":
            from bridge.zenoh.cast_session import CastSession

            return CastSession(self.system, bus, self.node, arrived)
        return CanLine(can_spec(self.system.deployment, bus), arrived, self.lateness)

    # ---- what rules do -----------------------------------------------------------------------

    def wait_beat(self, seconds: float, *states: LifeState, since: int = -1) -> HeardFrame | None:
        """The first heartbeat with one of these states, within `seconds` (s); no states: with any.

        None: none came.
        """
        begin = len(self.hearing) if since < 0 else since
        return self.hearing.wait(
            lambda f: f.kind is Heard.HEARTBEAT and (not states or f.state in states),
            begin,
            seconds,
        )

    def begin(self) -> HeardFrame:
        """Start the program; its first heartbeat. Raises UnreadyError if none comes in `patience`
        of the deployment.
        """
        if self.dead:
            raise UnreadyError(self.dead)
        sleep(APART - (monotonic_ns() - self._began_ns) * 1e-9)
        self._began_ns = monotonic_ns()
        mark = len(self.hearing)
        self.stopped = False
        self.lives.append(mark)
        if self.program.given:
            self.program.start()
        end = monotonic_ns() + round(self.system.deployment.patience * 1e9)
        while monotonic_ns() < end:
            beat = self.wait_beat(0.2, since=mark)
            if beat is not None:
                self.fresh = True
                return beat
            if not self.program.running:
                break
        text = f"no heartbeat of {self.node} came{self._said()}"
        self.dead = text if self.hearing.latest_beat() is None else ""
        raise UnreadyError(text)

    def _said(self) -> str:
        said = self.program.output() if self.program.given else ""
        return f"; its program printed: {said}" if said else ""

    def command(self, command: int) -> None:
        """NMT to the participant alone."""
        self.cast.command(command, self.number)

    def start(self, lead: float = LEAD, *, arm: bool = True) -> int:
        """EPOCH, ARM and START with all peers present; t = 0 (monotonic, ns)."""
        self.cast.silent = False
        sleep(0.15)  # peers are heard
        t0_ns = monotonic_ns() + round(lead * 1e9)
        if arm:
            self.command(NMT_ARM)
        self.cast.epoch(EpochFields(t0_ns))
        self.command(NMT_START)
        self.begin_run(t0_ns)
        return t0_ns

    def begin_run(self, t0_ns: int) -> None:
        """All peers have this t = 0 (monotonic, ns) from now on."""
        self.fresh = False
        self.cast.begin_run(t0_ns)
        self.runs.append((len(self.hearing), t0_ns))

    @property
    def now_s(self) -> float:
        """Time of the run, s; before its start: 0."""
        t0 = self.cast.t0_ns
        return 0.0 if t0 is None else (monotonic_ns() - t0) * 1e-9

    def make_active(self, needs: float = 3.0) -> None:
        """Let the participant be ACTIVE, with all roles as they should be. Raises UnreadyError.

        It is started anew if it has ended, or if the run ends in less than `needs` (s).
        """
        self.cast.restore()
        for attempt in range(8):
            if not self.lives and not self.program.given:
                self.begin()
            stuck = attempt == 5 and self.program.given
            if not self.program.running or self.now_s > self.run_end - needs or stuck:
                self.restart()
            beat = self.wait_beat(0.5)
            state = beat.state if beat else None
            if state is LifeState.ACTIVE and beat is not None and not beat.reasons:
                return
            if state is LifeState.STOPPING:
                state = self._after_ramp()
            if state in (LifeState.FAULT, LifeState.INACTIVE) and self._again():
                sleep(2 * self.slot + 0.02)
                return
        beat = self.hearing.latest_beat()
        said = f"{beat.text()} tells {beat.state_name}" if beat else f"no heartbeat{self._said()}"
        raise UnreadyError(f"it did not become ACTIVE: {said}")

    def _after_ramp(self) -> LifeState | None:
        beat = self.wait_beat(
            self.seconds("ramp") + OBEYS, LifeState.FAULT, LifeState.INACTIVE, LifeState.FINISHED
        )
        return beat.state if beat else None

    def _again(self) -> bool:
        """RESET, ARM, START; True if it is ACTIVE then."""
        if self.cast.t0_ns is None:
            self.start()
            return self.wait_beat(LEAD + OBEYS, LifeState.ACTIVE) is not None
        sleep(0.03)  # inputs are fed again
        mark = len(self.hearing)
        for command in (NMT_RESET, NMT_ARM, NMT_START):
            self.command(command)
            sleep(max(0.01, 1.5 * self.slot))
        found = self.hearing.wait(
            lambda f: f.kind in (Heard.SAMPLE, Heard.HEARTBEAT) and f.state is LifeState.ACTIVE,
            mark, 0.15 + 2 * self.seconds("heartbeat"),
        )  # fmt: skip
        return found is not None

    def make_waiting(self) -> None:
        """Let the participant wait for its first START, peers being silent unless a rule has let
        them speak. Raises UnreadyError.
        """
        self.cast.restore()
        beat = self.hearing.latest_beat()
        if self.lives and self.fresh and beat and beat.state is LifeState.INACTIVE:
            return
        if not self.lives and not self.program.given:
            self.begin()
            return
        self.end_life()
        self.begin()

    def end_life(self) -> None:
        """End the program, and the run; peers are silent. Raises UnreadyError."""
        if not self.program.given and self.lives:
            raise UnreadyError("it has to be started again, and the kit has no command for that")
        self.program.stop()
        self.cast.restore()
        self.cast.silent = True
        self.cast.begin_run(None)

    def restart(self) -> None:
        """A new life of the program, and a new run. Raises UnreadyError."""
        self.end_life()
        self.begin()
        self.start()
        self.wait_beat(LEAD + OBEYS, LifeState.ACTIVE)
