"""Outlets of a node for C: messages of its components, and messages it forwards."""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from bridge.deployment import drive_sequences
from bridge.deployment.carried import Carried
from bridge.deployment.cut import Outlet, guard_gate
from bridge.deployment.protection import Span, emulated, span
from bridge.deployment.system import System
from bridge.native import node as native
from bridge.native.pace import quantile
from bridge.native.safety import JOINTS
from bridge.safety.limits import GuardSpec, TorqueGuard
from bridge.wiring.commanded import CommandedDrives
from bridge.wiring.motors import EmulatedMotors
from cosim.base.errors import ScenarioError


@final
class OutletBindings:
    """Binds outlets to `struct`, and keeps the memory that they use.

    By message, or by the name of a torque that stays in the node: `guards`; by gate: `gates`,
    function and context; `outlets` in the plan's order.
    """

    def __init__(
        self, system: System, name: str, struct: native.NodeStruct, motors: EmulatedMotors
    ) -> None:
        self._system, self._name, self._struct = system, name, struct
        self._plan, self._spec = system.nodes[name], system.deployment.nodes[name]
        self._alive: list[Any] = []
        self._motors = motors
        self.guards: dict[str, TorqueGuard] = {}
        self.gates: dict[str, tuple[int, int]] = {}
        d = system.deployment
        self.commanded = CommandedDrives(
            drive_sequences.commanded_drives(d, self._plan),
            system.buses_of(name),
            struct,
            d.place("nodes", name),
        )
        self.outlets = self._outlets()
        self._insides()

    def keep(self, forwarded: Forwarding) -> None:
        """Keep an object as long as the outlets it is bound to."""
        self._alive.append(forwarded)

    def _outlets(self) -> c.Array[native.OutletStruct]:
        outlets = (native.OutletStruct * max(1, len(self._plan.outlets)))()
        for i, outlet in enumerate(self._plan.outlets):
            outlets[i] = self._outlet(outlet)
            self._motors.tell(outlets[i], outlet, i)
            self.gates[outlet.gate] = (
                native.address("outlet_pass"),
                c.addressof(outlets) + i * c.sizeof(native.OutletStruct),
            )
        self._struct.outlets = outlets
        self._struct.n_outlets = len(self._plan.outlets)
        return outlets

    def _outlet(self, outlet: Outlet) -> native.OutletStruct:
        encoding = self._system.messages[outlet.message].encoding
        sources = np.array(
            [p.start + k for p in outlet.parts for k in range(p.size)], dtype=np.int64
        )
        values = np.zeros(outlet.width)
        entry = native.OutletStruct(
            node=c.addressof(self._struct),
            message=c.pointer(encoding.message),
            width=outlet.width,
            bus=self._system.buses_of(self._name).index(outlet.bus),
            sources=sources.ctypes.data,
            values=values.ctypes.data,
            every=outlet.period,
            hit_ticks=outlet.ticks // outlet.period // self._plan.ticks,
            q=-1,
            dq=-1,
            measured_q=-1,
            measured_dq=-1,
        )
        self._command(entry, outlet)
        self._guard(entry, outlet)
        self._measured(entry, outlet)
        self._alive += [sources, values, encoding]
        return entry

    def _command(self, entry: native.OutletStruct, outlet: Outlet) -> None:
        """Bind the drive that a message commands, if it has a protocol of its own."""
        d = self._system.deployment
        if drive_sequences.commands(d, outlet):
            spec = d.messages[outlet.message]
            index = self.commanded.index(spec.bus, spec.drive)
            entry.commanded = c.pointer(self.commanded.structs[index])

    def _guard(self, entry: native.OutletStruct, outlet: Outlet) -> None:
        spec, d = self._spec.guard, self._system.deployment
        if spec is None:
            return
        slots, place = self._plan.plan.slots(), d.place("nodes", self._name, "guard")
        torque = slots.get(f"{outlet.component}.{spec.port}")
        at = span(outlet, torque, place)
        if at is None or torque is None:
            return
        period = outlet.ticks // outlet.period * self._system.plan.h
        guard = self._built(spec, at, period, place)
        entry.guard, entry.guarded, entry.joints = c.pointer(guard.struct), at.first, at.size
        for field, port in (("q", spec.q), ("dq", spec.dq)):
            slot = slots.get(f"{outlet.component}.{port}")
            if slot is not None and slot.size == torque.size:
                setattr(entry, field, slot.start + at.entry)
        self.guards[outlet.message] = guard

    def _insides(self) -> None:
        """Torques that stay in the node, guarded where their component gives them."""
        spec, d = self._spec.guard, self._system.deployment
        if spec is None:
            return
        guarded, slots = self._plan.guarded, self._plan.plan.slots()
        insides = (native.Inside * max(1, len(guarded)))()
        for entry, torque in zip(insides, guarded, strict=False):
            place = d.place("nodes", self._name, "guard")
            period = self._plan.plan.component(torque.component).period * self._plan.plan.h
            guard = self._built(spec, Span(0, 0, torque.size), period, place)
            entry.node, entry.guard = c.addressof(self._struct), c.pointer(guard.struct)
            entry.tau, entry.q, entry.dq = torque.start, -1, -1
            for field, port in (("q", spec.q), ("dq", spec.dq)):
                slot = slots.get(f"{torque.component}.{port}")
                if slot is not None and slot.size == torque.size:
                    setattr(entry, field, slot.start)
            self.guards[torque.name] = guard
            self.gates[guard_gate(torque)] = native.address("inside_pass"), c.addressof(entry)
        self._struct.insides, self._struct.n_insides = insides, len(guarded)
        self._alive.append(insides)

    def _built(self, spec: GuardSpec, at: Span, period: float, place: str) -> TorqueGuard:
        if at.size > JOINTS:
            raise ScenarioError(f"{at.size} joints, expected at most {JOINTS}", place)
        guard = spec.part(at.entry, at.size).build(at.size, period, place)
        self._alive.append(guard)
        return guard

    def _measured(self, entry: native.OutletStruct, outlet: Outlet) -> None:
        """Positions and velocities leave as the encoders of the node's drive see them."""
        spec, d = self._spec.drive, self._system.deployment
        if spec is None or not any(i.target.port == spec.port for i in self._plan.inlets):
            return
        place, slots = d.place("nodes", self._name, "drive"), self._plan.plan.slots()
        q, dq = (
            span(outlet, slots.get(f"{outlet.component}.{port}"), place)
            for port in (spec.q, spec.dq)
        )
        if q is None and dq is None:
            return
        joints = (q or dq).size  # type: ignore[union-attr]
        drive = emulated(spec, d).encoders().build(joints, self._plan.h, place)
        entry.measured_q = q.first if q else -1
        entry.measured_dq = dq.first if dq else -1
        entry.drive = c.pointer(drive.struct)
        self._alive.append(drive)


@final
class Forwarding:
    """Messages that are made of others, `made` by name; `alive` keeps their memory.

    `buses`: of the node, or none: nothing is sent (replay).
    """

    def __init__(self, forwarded: Sequence[Carried], buses: Sequence[str] = ()) -> None:
        self._array = (native.ForwardStruct * max(1, len(forwarded)))()
        self._alive: list[Any] = []
        for entry, carried in zip(self._array, forwarded, strict=False):
            assert carried.forward is not None
            sources = np.array(carried.forward.sources, dtype=np.int32)
            values = np.zeros(sources.size)
            entry.message = c.pointer(carried.encoding.message)
            entry.sources, entry.values = sources.ctypes.data, values.ctypes.data
            entry.width = sources.size
            entry.bus = buses.index(carried.bus) if buses else -1
            self._alive += [sources, values, carried]
        self.made = {m.name: e for m, e in zip(forwarded, self._array, strict=False)}

    def bind(self, owner: native.Reception | native.OutletStruct) -> None:
        """All of them are made when `owner` has a sample."""
        owner.forwards, owner.n_forwards = self._array, len(self.made)


def forwarded_facts(entry: native.ForwardStruct) -> dict[str, Any]:
    """Samples sent and not handed over; us from their arrival to their hand-over (wall clock)."""
    transit = entry.transit
    us = {f"p{q:g}": quantile(transit, q / 100) / 1e3 for q in (50, 99) if transit.count}
    if transit.count:
        us["max"] = transit.maximum / 1e3
    return {"sent": int(entry.sent), "failed": int(entry.failed), "transit_us": us}


def forwardings(
    system: System, name: str, receptions: Mapping[str, native.Reception]
) -> list[Forwarding]:
    """Bound to the receptions of a node, those of each message together."""
    found = []
    for message, reception in receptions.items():
        made = [system.messages[f.message] for f in system.nodes[name].forwards if f.of == message]
        if made:
            found.append(Forwarding(made, system.buses_of(name)))
            found[-1].bind(reception)
    return found
