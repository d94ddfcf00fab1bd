"""A node's C struct, made of its plan, its deployment, its buses and the clock it runs on.

What a node is does not depend on the clock; what is behind its inlets and buses does. Everything C
points to is kept alive by :class:`Wired`.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bridge import apart, drives, safety
from bridge.cut import Inlet, NodePlan, Outlet
from bridge.deploy import StaleSpec
from bridge.journal import Journal
from bridge.latency import delays_for, newest_for
from bridge.native import message as messages
from bridge.native import node as native
from bridge.native.bus import Bus, BusStruct
from bridge.native.delay import DelayLine
from bridge.native.frame import Frame
from bridge.native.safety import Peer
from bridge.protect import Span, age_slot, emulated, input_of, limits, span
from bridge.system import Carried, System
from cosim import native as engine_native
from cosim.engine import Engine
from cosim.errors import ScenarioError
from cosim.plan import Wire

Rows = NDArray[np.void]


def row_dtype(plan: NodePlan) -> np.dtype[np.void]:
    """A row of a node's journal (``row_t`` and what follows), one a slot."""
    head = ("slot", "deadline_ns", "woke_ns", "received_ns", "send_ns", "done_ns")
    inlet: Any = [(name, "<i8") for name in ("held", "newest", "age_ns", "transit_ns")]
    width = sum(o.width for o in plan.outlets)
    fields: list[Any] = [(name, "<i8") for name in head]
    fields += [("state", "<i4"), ("command", "<i4")]
    fields += [(name, "<u4") for name in ("now", "reasons", "guard", "flags")]
    fields += [
        ("scale", "<f8"),
        ("inlets", inlet, (len(plan.inlets),)),
        ("sent", "<f8", (width,)),
        ("signals", "<f8", (plan.plan.n_signals,)),
    ]
    return np.dtype(fields)


@final
class Wired:
    """A node ready to run: `struct` for C, `engine` initialized, `journal` open.

    `buses`: by name, those of :meth:`System.buses_of`; none for a replay. `clock`: WALL, SIMULATED
    or REPLAY of :mod:`bridge.native.node`. Use as a context manager: FMUs are freed at the end.
    """

    def __init__(
        self,
        system: System,
        name: str,
        buses: Mapping[str, Bus],
        journal: Path,
        clock: int,
        *,
        boots: int = 0,
        real: bool = False,
    ) -> None:
        self.system, self.name = system, name
        self.plan = system.nodes[name]
        self.spec = system.deployment.nodes[name]
        self.real = real  # whether what it says may move real drives
        self._alive: list[Any] = []
        self._buses = [buses[b] for b in system.buses_of(name)] if buses else []
        self._names = system.buses_of(name)
        self.struct = native.Node(clock=clock, number=self.spec.number, boots=boots)
        self.receivers: dict[str, messages.Receiver] = {}
        self.lines: dict[str, DelayLine] = {}
        self.guards: dict[str, safety.TorqueGuard] = {}
        self.drive: drives.Drive | None = None  # the last of
        self.drives: list[drives.Drive] = []
        self._gates: dict[str, tuple[int, int]] = {}
        self._time()
        self._bind_buses()
        self._receptions = self._make_receptions()
        self._bind_inlets()
        self._bind_outlets()
        self._bind_peers()
        self.journal = Journal.create(journal, row_dtype(self.plan), self.plan.slots + 8)
        self._journals = [self.journal]
        self.struct.journal = c.cast(self.journal.address, type(self.struct.journal))
        self._offsets()
        self.engine = Engine(self.plan.plan, gates=self._gates)

    def __enter__(self) -> Wired:
        self.engine.initialize()
        self.engine.prepare(self.plan.slots)
        state, s = self.engine.state, self.struct
        s.engine, s.signals = c.addressof(state), self.engine.signals.ctypes.data
        s.run = engine_native.address(engine_native.library().engine_run)
        kind = engine_native.EngineState
        s.record = s.engine + kind.record.offset
        s.record_row = s.engine + kind.row.offset
        s.engine_tick = s.engine + kind.tick.offset
        s.n_signals = self.plan.plan.n_signals
        self._bind_played(state.players)
        return self

    def _bind_played(self, players: int) -> None:
        """Weights of edges go on where the run is, also in a second life."""
        kind, plan = engine_native.Player, self.plan.plan
        rows = (native.Played * max(1, len(plan.players)))()
        for i, player in enumerate(plan.players):
            rows[i].row = players + i * c.sizeof(kind) + kind.row.offset
            rows[i].period = plan.component(player.target.component).period
        self.struct.played, self.struct.n_played = rows, len(plan.players)
        self._alive.append(rows)

    def __exit__(self, *_: object) -> None:
        self.engine.close()
        for journal in self._journals:
            journal.close()

    def keep(self, journal: Journal) -> None:
        """Another journal C writes into: closed with this."""
        self._journals.append(journal)

    # ---- time, buses, peers ------------------------------------------------------------------

    def _time(self) -> None:
        d, s = self.system.deployment, self.struct
        place = ("nodes", self.name)
        s.h, s.h_ns = self.plan.h, round(self.plan.h * 1e9)
        s.phase_ns = round(d.seconds(self.spec.phase, *place, "phase") * 1e9)
        s.slots = self.plan.slots
        s.overrun_ns = round(d.seconds(self.spec.overrun, *place, "overrun") * 1e9)
        s.simulated = not self.real
        s.life = safety.LifeSpec(self.spec.ramp).build(self.plan.h, d.place(*place))
        beat = d.seconds(self.spec.heartbeat, *place, "heartbeat")
        s.heartbeat_slots = max(1, round(beat / self.plan.h)) if beat > 0 else 0
        if d.sync == self.name:
            s.sync_slots = max(1, self.system.sync_ticks // self.plan.ticks)

    def _bind_buses(self) -> None:
        n = len(self._buses)
        structs = (BusStruct * max(1, n))()
        for i, bus in enumerate(self._buses):
            structs[i] = bus.struct
            structs[i].number = i
            bus.struct = structs[i]
        pending, has = (Frame * max(1, n))(), (c.c_int32 * max(1, n))()
        self.struct.buses, self.struct.n_buses = c.addressof(structs), n
        self.struct.pending, self.struct.has_pending = pending, c.addressof(has)
        self._alive += [structs, pending, has]

    def _bind_peers(self) -> None:
        d, s = self.system.deployment, self.struct
        services = [self.system.services[b] for b in self._names if b in self.system.services]
        if not services:
            return
        beats = {n: beat for service in services for n, beat in service.heartbeats.items()}
        for field in ("sync", "nmt", "estop"):
            found = next((e for e in (getattr(x, field) for x in services) if e), None)
            if found is not None:
                setattr(s, field, c.pointer(found.message))
        if self.spec.number in beats:
            s.heartbeat = c.pointer(beats[self.spec.number].message)
        within = d.seconds(self.spec.within, "nodes", self.name, "within")
        known = [p for p in self.system.peers_of(self.name) if d.nodes[p].number in beats]
        peers = (Peer * max(1, len(known)))()
        pointers = (c.c_void_p * max(1, len(known)))()
        for i, other in enumerate(known):
            number = d.nodes[other].number
            required = other in self.spec.requires
            peers[i] = safety.PeerSpec(number, within, required).build(0)
            pointers[i] = c.addressof(beats[number].message)
        s.peers, s.n_peers = c.addressof(peers), len(known)
        s.peer_messages = c.addressof(pointers)
        self.peers = dict(zip(known, peers, strict=False))
        self._alive += [peers, pointers, beats, services]

    # ---- receiving ---------------------------------------------------------------------------

    def _make_receptions(self) -> dict[str, int]:
        """Number of each message heard; they are bound to the struct."""
        heard = self.system.heard_by(self.name)
        made = (native.Reception * max(1, len(heard)))()
        for i, name in enumerate(heard):
            self._reception(made[i], self.system.messages[name])
        self.struct.receptions, self.struct.n_receptions = c.addressof(made), len(heard)
        self._made = made
        found = dict(zip(heard, made, strict=False))
        compared = apart.structs(self.system.deployment, self.name, self.system.messages, found)
        aparts = (native.Apart * max(1, len(compared)))(*compared)
        self.struct.aparts, self.struct.n_aparts = c.addressof(aparts), len(compared)
        self._alive += [made, aparts]
        return {name: i for i, name in enumerate(heard)}

    def _reception(self, r: native.Reception, carried: Carried) -> None:
        message = carried.encoding.message
        receiver = messages.receiver(carried.period_ns, messages.Profile(message.e2e))
        values = np.zeros(carried.outlet.width)
        r.message, r.receiver = c.pointer(message), c.pointer(receiver)
        r.values, r.width = values.ctypes.data, values.size
        r.bus = self._names.index(carried.bus)
        r.period_ns, r.offset_ns = carried.period_ns, carried.offset_ns
        r.max_age_ns = carried.max_age_ns
        r.newest = r.arrival_ns = -1
        r.time_bits = message.header[message.time].length if message.time >= 0 else 0
        r.accept_simulated = not self.real
        r.sender = self.system.deployment.nodes[carried.node].number
        self.receivers[carried.name] = receiver
        self._alive += [receiver, values]

    def _bind_inlets(self) -> None:
        inlets = (native.Inlet * max(1, len(self.plan.inlets)))()
        for i, inlet in enumerate(self.plan.inlets):
            carried = self.system.messages[inlet.message]
            line = self._line(inlet, carried)
            self.lines[inlet.target.name] = line
            initial = np.zeros(inlet.target.size)
            entry = native.Inlet(
                node=c.addressof(self.struct),
                reception=c.pointer(self._made[self._receptions[inlet.message]]),
                delay=c.pointer(line.struct),
                first=inlet.first,
                count=inlet.target.size,
                target=inlet.target.start,
                gain=inlet.gain,
                offset=inlet.offset,
                period=inlet.ticks // self.plan.ticks,
                held=-1,
                newest=-1,
                last_newest=-1,
                link_age=-1 if inlet.age is None else inlet.age.start,
                initial=initial.ctypes.data,
                later=self.plan.plan.component(inlet.component).kind == "continuous",
            )
            self._alive.append(initial)
            self._stale(entry, inlet)
            self._drive(entry, inlet)
            inlets[i] = entry
            self._gates[inlet.gate] = (
                native.address("inlet_pass"),
                c.addressof(inlets) + i * c.sizeof(native.Inlet),
            )
        self.inlets = inlets
        self.struct.inlets, self.struct.n_inlets = c.addressof(inlets), len(self.plan.inlets)

    def _line(self, inlet: Inlet, carried: Carried) -> DelayLine:
        plan, sent = self.system.plan, carried.outlet.ticks
        if inlet.link is not None and self.system.deployment.latency:
            spec = delays_for(inlet.link, plan.ticks, carried.outlet.period)
        else:
            edge = inlet.link or Wire(inlet.source, inlet.target)
            spec = newest_for(edge, sent, inlet.ticks, plan.h)
        return spec.line(self.struct.phase_ns - carried.offset_ns)

    def _stale(self, entry: native.Inlet, inlet: Inlet) -> None:
        d = self.system.deployment
        name = f"{inlet.component}.{inlet.target.port}"
        spec = self.spec.stale.get(name, StaleSpec())
        place = ("nodes", self.name, "stale", name)
        entry.age = -1
        entry.stop_ns = round(d.seconds(spec.stop, *place, "stop") * 1e9)
        if spec.age:
            entry.age = age_slot(self.plan, inlet, spec.age, d.place(*place, "age"))

    def _drive(self, entry: native.Inlet, inlet: Inlet) -> None:
        spec, d = self.spec.drive, self.system.deployment
        entry.q = entry.dq = -1
        if spec is None or inlet.target.port != spec.port:
            return
        place = d.place("nodes", self.name, "drive")
        joints, component = inlet.target.size, inlet.component
        q, dq, tau = (
            input_of(self.plan, component, port, place).start
            for port in (spec.q, spec.dq, spec.port)
        )
        at = Span(0, inlet.target.start - tau, joints)
        self.drive = emulated(spec, d, at).build(joints, inlet.ticks * self.system.plan.h, place)
        self.drives.append(self.drive)
        command = np.zeros(joints)
        entry.drive = c.pointer(self.drive.struct)
        entry.command = command.ctypes.data
        entry.q, entry.dq = q + at.entry, dq + at.entry
        self._alive.append(command)

    # ---- sending -----------------------------------------------------------------------------

    def _bind_outlets(self) -> None:
        outlets = (native.Outlet * max(1, len(self.plan.outlets)))()
        for i, outlet in enumerate(self.plan.outlets):
            carried = self.system.messages[outlet.message]
            sources = np.array(
                [p.start + k for p in outlet.parts for k in range(p.size)], dtype=np.int64
            )
            values = np.zeros(outlet.width)
            entry = native.Outlet(
                node=c.addressof(self.struct),
                message=c.pointer(carried.encoding.message),
                width=outlet.width,
                bus=self._names.index(outlet.bus),
                sources=sources.ctypes.data,
                values=values.ctypes.data,
                every=outlet.period,
                hit_ticks=outlet.ticks // outlet.period // self.plan.ticks,
                q=-1,
                dq=-1,
                measured_q=-1,
                measured_dq=-1,
            )
            self._guard(entry, outlet)
            self._measured(entry, outlet)
            outlets[i] = entry
            self._gates[outlet.gate] = (
                native.address("outlet_pass"),
                c.addressof(outlets) + i * c.sizeof(native.Outlet),
            )
            self._alive += [sources, values, carried.encoding]
        self.outlets = outlets
        self.struct.outlets, self.struct.n_outlets = c.addressof(outlets), len(self.plan.outlets)

    def _guard(self, entry: native.Outlet, outlet: Outlet) -> None:
        spec, d = self.spec.guard, self.system.deployment
        if spec is None:
            return
        slots, place = self.plan.plan.slots(), d.place("nodes", self.name, "guard")
        torque = slots.get(f"{outlet.component}.{spec.port}")
        at = span(outlet, torque, place)
        if at is None or torque is None:
            return
        if at.size > native.JOINTS:
            raise ScenarioError(f"{at.size} joints, expected at most {native.JOINTS}", place)
        period = outlet.ticks // outlet.period * self.system.plan.h
        guard = limits(spec, at).build(at.size, period, place)
        entry.guard, entry.guarded, entry.joints = c.pointer(guard.struct), at.first, at.size
        for field, port in (("q", spec.q), ("dq", spec.dq)):
            slot = slots.get(f"{outlet.component}.{port}")
            if slot is not None and slot.size == torque.size:
                setattr(entry, field, slot.start + at.entry)
        self.guards[outlet.message] = guard
        self._alive.append(guard)

    def _measured(self, entry: native.Outlet, outlet: Outlet) -> None:
        """Positions and velocities leave as the drive's encoders see them."""
        spec, d = self.spec.drive, self.system.deployment
        if spec is None or not self.drives:
            return
        place, slots = d.place("nodes", self.name, "drive"), self.plan.plan.slots()
        q, dq = (
            span(outlet, slots.get(f"{outlet.component}.{port}"), place)
            for port in (spec.q, spec.dq)
        )
        if q is None and dq is None:
            return
        joints = (q or dq).size  # type: ignore[union-attr]
        drive = replace(emulated(spec, d), tau_max=None).build(joints, self.plan.h, place)
        entry.measured_q = q.first if q else -1
        entry.measured_dq = dq.first if dq else -1
        entry.drive = c.pointer(drive.struct)
        self._alive.append(drive)

    def _offsets(self) -> None:
        fields = row_dtype(self.plan).fields
        assert fields is not None
        self.struct.row_size = row_dtype(self.plan).itemsize
        self.struct.inlet_offset = fields["inlets"][1]
        self.struct.outlet_offset = fields["sent"][1]
        self.struct.signals_offset = fields["signals"][1]
