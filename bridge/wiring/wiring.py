"""A node's C struct, built from its plan, its deployment, its buses and its clock.

The struct does not depend on the clock; the connections of inlets and buses do.
:class:`WiredNode` keeps all memory alive to which the C code points.
"""

from __future__ import annotations

import ctypes as c
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bridge.deployment.cut import NodePlan
from bridge.deployment.protection import drives_by
from bridge.deployment.services import BEATS, Service
from bridge.deployment.system import System
from bridge.drives import model as drives
from bridge.native import node as native
from bridge.native.bus import Bus, BusStruct
from bridge.native.delay import DelayLine
from bridge.native.frame import Frame
from bridge.native.journal import Journal
from bridge.native.message import Receiver
from bridge.native.safety import Peer
from bridge.safety import limits
from bridge.wiring.commanded import CommandedDrives
from bridge.wiring.inlets import InletBindings
from bridge.wiring.outlets import OutletBindings, forwardings
from cosim.base.clock import stopwatch
from cosim.base.errors import CosimError, RunError
from cosim.engine.binding import part
from cosim.engine.engine import Engine
from cosim.native import shared, structs
from cosim.native.enums import Code

Rows = NDArray[np.void]
#: s from a START whose time has passed to the first slot, and as often as starting takes, besides.
LEAD, LONGER = 0.05, 3.0
#: Of each inlet in a row: ``inlet_row_t``.
INLET_ROW = ("held", "newest", "age_ns", "transit_ns", "requests")
#: Kind of the file of what a life heard, beside its journal.
HEARD = "heard"


def row_dtype(plan: NodePlan) -> np.dtype[np.void]:
    """A row of a node's journal (``row_t`` and what follows), one a slot."""
    head = ("slot", "deadline_ns", "woke_ns", "received_ns", "send_ns", "done_ns")
    inlet: Any = [(name, "<i8") for name in INLET_ROW]
    width = sum(o.width for o in plan.outlets)
    fields: list[Any] = [(name, "<i8") for name in head]
    fields += [("state", "<i4"), ("commands", "<u4")]
    fields += [(name, "<u4") for name in ("now", "reasons", "guard", "flags")]
    fields += [
        ("scale", "<f8"),
        ("serving", "<u8"),
        ("inlets", inlet, (len(plan.inlets),)),
        ("sent", "<f8", (width,)),
        ("signals", "<f8", (plan.plan.n_signals,)),
    ]
    return np.dtype(fields)


def heard_dtype(system: System, name: str) -> np.dtype[np.void]:
    """A row of the journal of what a node heard (``heard_t``): a sample that it accepted.

    `message`: its number in :meth:`System.received_by`; `sequence`: as the receiver numbered it;
    `values`: decoded, those of shorter messages end with zeros.
    """
    width = max((system.messages[m].outlet.width for m in system.received_by(name)), default=0)
    fields: list[Any] = [("sequence", "<i8"), ("arrival_ns", "<i8")]
    return np.dtype([*fields, ("message", "<i4"), ("status", "<u4"), ("values", "<f8", (width,))])


def heard_rows(system: System, name: str) -> int:
    """Rows for the samples that a node receives in a run: all, a quarter more, and 64."""
    seconds = system.nodes[name].slots * system.nodes[name].h
    periods = [system.messages[m].period_ns for m in system.received_by(name)]
    return sum(64 + int(1.25e9 * seconds / period) for period in periods) or 1


@final
class WiredNode:
    """A node ready to run: `struct` for C, `engine` initialized, `journal` open.

    `heard`: the journal of what it hears; a replay has none.

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
        self.failed = ""  # why it could not join a run
        self._alive: list[Any] = []
        self._buses = [buses[b] for b in system.buses_of(name)] if buses else []
        self._names = system.buses_of(name)
        self.struct = native.NodeStruct(clock=clock, number=self.spec.number, boots=boots)
        self._time()
        self._bind_buses()
        self.inlet_bindings = InletBindings(system, name, self.struct, real=real)
        self.outlet_bindings = OutletBindings(system, name, self.struct, self.inlet_bindings.motors)
        self.struct.life.moves = len(self.inlet_bindings.own_drives) > 0
        self.commanded.watch(system, self.inlet_bindings.receptions)
        self.forwarding = forwardings(system, name, self.inlet_bindings.receptions)
        self.struct.gateway = len(self.forwarding) > 0
        self._bind_peers()
        self.journal = Journal.create(journal, row_dtype(self.plan), self.plan.slots + 8)
        self._journals = [self.journal]
        self.heard: Journal | None = None
        if clock != native.REPLAY:
            self.heard = Journal.create(
                journal.with_suffix(f".{HEARD}"),
                heard_dtype(system, name),
                heard_rows(system, name),
            )
            self.keep(self.heard)
            self.struct.heard = c.cast(self.heard.address, type(self.struct.heard))
        self.struct.journal = c.cast(self.journal.address, type(self.struct.journal))
        self._offsets()
        self.engine = Engine(
            self.plan.plan, gates={**self.inlet_bindings.gates, **self.outlet_bindings.gates}
        )

    def __enter__(self) -> WiredNode:
        began = stopwatch()
        self._initialize(0)
        self.struct.lead_ns = round((LEAD + LONGER * began()) * 1e9)
        self._joined = native.Joined(self._join)
        self.struct.joined = c.cast(self._joined, c.c_void_p)
        return self

    def _join(self, slot: int) -> int:
        """Called from C where a life begins in the middle of a run; 0, or 1 where it cannot."""
        try:
            with self._feeding():
                self.begin(slot)
        except CosimError as error:
            self.failed = str(error)
            return 1
        return 0

    @contextmanager
    def _feeding(self) -> Iterator[None]:
        """Drives that this node commands are fed while Python works in place of its loop."""
        if not self.struct.n_commanded:
            yield
            return
        stop = c.c_int32(0)
        feed = native.functions().bringup_feed_until
        thread = threading.Thread(target=feed, args=(c.byref(self.struct), c.byref(stop)))
        thread.start()
        try:
            yield
        finally:
            stop.value = 1
            thread.join()

    def begin(self, slot: int) -> None:
        """Start all components once more, at the time of `slot`: this life begins there, and they
        see the time of the run. Inputs keep what was heard before. Raises CosimError.
        """
        before = self.engine.signals.copy()
        self._initialize(slot)
        for inlet in self.plan.inlets:
            part(self.engine.signals, inlet.target)[:] = part(before, inlet.target)

    def _initialize(self, slot: int) -> None:
        self.engine.initialize(slot)
        if self.engine.ended is not None:
            raise RunError(f"{self.engine.ended} before the first step; there is nothing to run")
        self.engine.prepare(self.plan.slots)
        state, s = self.engine.state, self.struct
        s.engine, s.signals = c.addressof(state), self.engine.signals.ctypes.data
        s.run = shared.address(shared.library().engine_run)
        s.record, s.record_row = (
            s.engine + f.offset for f in (type(state).record, type(state).row)
        )
        self._bind_played(state)

    def _bind_played(self, state: structs.EngineStruct) -> None:
        """Tables of edges, weights and links, go on where the run is, also in a second life."""
        kinds = {
            Code.PLAY: (
                state.players,
                structs.PlayerStruct,
                structs.PlayerStruct.row.offset,
            ),
            Code.PULL: (state.links, structs.LinkStruct, structs.LinkStruct.row.offset),
            Code.PUSH: (
                state.links,
                structs.LinkStruct,
                structs.LinkStruct.before.offset,
            ),
        }
        rows = []
        for o in self.plan.plan.operations:
            if o.code in kinds:
                start, kind, field = kinds[Code(o.code)]
                rows.append(native.PlayedStruct(start + o.index * c.sizeof(kind) + field, o.period))
        played = (native.PlayedStruct * max(1, len(rows)))(*rows)
        self.struct.played, self.struct.n_played = played, len(rows)
        self._alive.append(played)

    def __exit__(self, *_: object) -> None:
        self.engine.close()
        for journal in self._journals:
            journal.close()

    @property
    def buses(self) -> Sequence[Bus]:
        """In the order of ``System.buses_of``; none in a replay."""
        return self._buses

    @property
    def receivers(self) -> Mapping[str, Receiver]:
        """By received message: the counters of its frames."""
        return self.inlet_bindings.receivers

    @property
    def lines(self) -> Mapping[str, DelayLine]:
        """By the name of the input behind it."""
        return self.inlet_bindings.lines

    @property
    def drives(self) -> Sequence[drives.Drive]:
        """Emulated, one an inlet of torques."""
        return self.inlet_bindings.drives

    @property
    def commanded(self) -> CommandedDrives:
        """Drives with protocols of their own that it commands."""
        return self.outlet_bindings.commanded

    @property
    def guards(self) -> Mapping[str, limits.TorqueGuard]:
        """By message sent."""
        return self.outlet_bindings.guards

    @property
    def forwards(self) -> Mapping[str, native.ForwardStruct]:
        """By message: what a gateway makes of others."""
        return {name: f for part in self.forwarding for name, f in part.made.items()}

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
        s.patience_ns = round(d.patience * 1e9)
        overrun = d.seconds(self.spec.overrun, *place, "overrun")
        s.overrun_ns = round(overrun * 1e9) if self.spec.components else 0  # gateways move nothing
        s.simulated = not self.real
        s.life = limits.LifeSpec(self.spec.ramp).build(self.plan.h, d.place(*place))
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
            heard = self.system.accepts(self.name, self._names[i])
            bus.accept([one.any_format() for one in heard])  # a wrong format is counted by message
        pending, has = (Frame * max(1, n))(), (c.c_int32 * max(1, n))()
        self.struct.buses, self.struct.n_buses = structs, n
        self.struct.pending, self.struct.has_pending = pending, c.addressof(has)
        self._alive += [structs, pending, has]

    def _bind_peers(self) -> None:
        d, s = self.system.deployment, self.struct
        within = d.seconds(self.spec.within, "nodes", self.name, "within")
        known = self.system.peers_of(self.name)
        peers = (Peer * max(1, len(known)))()
        for i, other in enumerate(known):
            required = other in self.spec.requires
            peers[i] = limits.PeerSpec(d.nodes[other].number, within, required).build(0)
            peers[i].takes = self._takes_torque(other)
        s.peers, s.n_peers = peers, len(known)
        self.peers = dict(zip(known, peers, strict=False))
        services = (native.Services * max(1, len(self._names)))()
        for bus, entry in zip(self._names, services, strict=False):
            self._bind_services(bus, entry, known)
        s.services = services
        self._alive += [peers, services]

    def _takes_torque(self, other: str) -> bool:
        """True if drives of another node take torques of this one."""
        plan, spec = self.system.nodes[other], self.system.deployment.nodes[other]
        sent = (name for name, m in self.system.messages.items() if m.node == self.name)
        return any(drives_by(plan, spec, name) for name in sent)

    def _bind_services(self, bus: str, entry: native.Services, peers: Sequence[str]) -> None:
        """The services of one bus, and the heartbeats of `peers` there."""
        service, nodes = self.system.services[bus], self.system.deployment.nodes
        for field in ("sync", "nmt", "estop", "epoch"):
            encoding = getattr(service, field)
            if encoding is not None:
                setattr(entry, field, c.pointer(encoding.message))
        if self.spec.number in service.heartbeats:
            entry.heartbeat = c.pointer(service.heartbeats[self.spec.number].message)
        if self.spec.number in service.host_heartbeats:
            self._bind_host(bus, entry, service)
        pointers = (c.c_void_p * max(1, len(peers)))()
        for i, other in enumerate(peers):
            beat = service.heartbeats.get(nodes[other].number)
            if beat is not None and bus in self.system.buses_of(other):
                pointers[i] = c.addressof(beat.message)
        entry.peers = c.addressof(pointers)
        self._alive += [pointers, service]

    def _bind_host(self, bus: str, entry: native.Services, service: Service) -> None:
        """CANopen's heartbeat and SYNC for drives that this node commands."""
        entry.host_heartbeat = c.pointer(service.host_heartbeats[self.spec.number].message)
        period = round(service.timeout * 1e9) // BEATS
        self.struct.host_ns = min(self.struct.host_ns or period, period)
        if service.host_sync is not None:
            entry.host_sync = c.pointer(service.host_sync.message)
            sent = [o.ticks // self.plan.ticks for o in self.plan.outlets if o.bus == bus]
            entry.host_sync_slots = min(sent)

    def _offsets(self) -> None:
        fields = row_dtype(self.plan).fields
        assert fields is not None
        self.struct.row_size = row_dtype(self.plan).itemsize
        self.struct.inlet_offset = fields["inlets"][1]
        self.struct.outlet_offset = fields["sent"][1]
        self.struct.signals_offset = fields["signals"][1]
