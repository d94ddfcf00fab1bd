"""Inlets of a node for C: subscribed messages, and the inputs that they feed."""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from bridge.deployment import drive_sequences, ranges, start_positions
from bridge.deployment.carried import Carried
from bridge.deployment.cut import Inlet
from bridge.deployment.latency import delays_for, zero_delay
from bridge.deployment.protection import age_slot, drives_by, emulated, input_of, torque_age
from bridge.deployment.spec import StaleSpec
from bridge.deployment.system import System
from bridge.drives import model
from bridge.native import message as messages
from bridge.native import node as native
from bridge.native.delay import DelayLine
from bridge.native.vendor import VendorFault
from bridge.wiring.motors import EmulatedMotors
from cosim.schedule.parts import Wire

#: A node waits at least so many periods of a message, however short the deployment's `silence`.
PERIODS = 4
#: s from power to a drive of our own protocol that can be enabled (assumed).
BOOT = 0.3


@final
class InletBindings:
    """Binds the inlets to `struct`, and keeps the memory that they use.

    By message: `receptions`, `receivers`; by target: `lines`; by gate: `gates`, function and
    context; `inlets` in the plan's order. `real`: simulated samples are refused.
    """

    def __init__(self, system: System, name: str, struct: native.NodeStruct, *, real: bool) -> None:
        self._system, self._name, self._struct, self._real = system, name, struct, real
        self._plan, self._spec = system.nodes[name], system.deployment.nodes[name]
        self._buses = system.buses_of(name)
        self._alive: list[Any] = []
        self._commanded = drive_sequences.commanded_drives(system.deployment, self._plan)
        self.receivers: dict[str, messages.Receiver] = {}
        self.lines: dict[str, DelayLine] = {}
        self.drives: list[model.Drive] = []
        self.gates: dict[str, tuple[int, int]] = {}
        self.receptions = self._receptions()
        self._aparts()
        self.motors = EmulatedMotors(system, name, struct)
        self.inlets = self._inlets()

    @property
    def own_drives(self) -> list[native.InletStruct]:
        """The torque inputs behind emulated drives of our own protocol."""
        there = list(self.inlets)[: len(self._plan.inlets)]
        return [x for x in there if x.drive and not x.motor]

    def suffer(self, faults: Sequence[tuple[float, int, int]]) -> None:
        """Let faults (t in s, VENDOR_..., code) happen to the drives of our own protocol."""
        found: list[native.MotorFault] = []
        for t, fault, code in faults:
            reboots = fault == VendorFault.REBOOT
            found.append(native.MotorFault(round(t * 1e9), fault, 1 if reboots else code))
            if reboots:
                found.append(native.MotorFault(round((t + BOOT) * 1e9), fault, 0))
        table = (native.MotorFault * max(1, len(found)))(*sorted(found, key=lambda f: f.t_ns))
        for entry in self.own_drives:
            entry.faults, entry.n_faults, entry.happened = table, len(found), 0
        self._alive.append(table)

    def _receptions(self) -> Mapping[str, native.Reception]:
        heard = self._system.received_by(self._name)
        made = (native.Reception * max(1, len(heard)))()
        for i, name in enumerate(heard):
            self._reception(made[i], self._system.messages[name])
        self._struct.receptions, self._struct.n_receptions = made, len(heard)
        self._alive.append(made)
        return dict(zip(heard, made, strict=False))

    def _reception(self, r: native.Reception, carried: Carried) -> None:
        message = carried.encoding.message
        receiver = messages.receiver(
            carried.period_ns,
            messages.E2EProfile(message.e2e),
            carried.offset_ns,
            message.header[message.time].length if message.time >= 0 else 0,
        )
        values = np.zeros(carried.outlet.width)
        r.message, r.receiver = c.pointer(message), c.pointer(receiver)
        r.values, r.width = values.ctypes.data, values.size
        r.bus = self._buses.index(carried.bus)
        r.period_ns, r.offset_ns = carried.period_ns, carried.offset_ns
        r.max_age_ns = self._max_age(carried)
        limits = ranges.limits(self._system, self._name, carried)
        r.limits = (messages.Limit * len(limits))(*limits)
        r.newest = r.arrival_ns = r.previewed_ns = r.promised = -1
        r.accept_simulated = not self._real
        r.drive = self._drive_of(carried)
        r.sender = self._system.deployment.nodes[carried.node].number
        self.receivers[carried.name] = receiver
        self._alive += [receiver, values]

    def _drive_of(self, carried: Carried) -> int:
        """The drive whose position a message carries, of those this node commands; -1: none."""
        spec = self._system.deployment.messages[carried.name]
        q = any(part.port == "q" for part in carried.outlet.parts)
        if not spec.profile or not q:
            return -1
        found = [
            i for i, x in enumerate(self._commanded) if (x.bus, x.node) == (spec.bus, spec.drive)
        ]
        return found[0] if found else -1

    def _max_age(self, carried: Carried) -> int:
        """The limit of the message, or that of the drive it moves, if smaller; ns, 0: none."""
        spec, d = self._spec.drive, self._system.deployment
        ages = [carried.max_age_ns]
        if spec is not None and drives_by(self._plan, self._spec, carried.name):
            ages.append(torque_age(spec, d, d.place("nodes", self._name, "drive")))
        return min((age for age in ages if age), default=0)

    def _aparts(self) -> None:
        """Positions that are compared before the start."""
        system = self._system
        found = start_positions.structs(
            system.deployment, self._name, system.messages, self.receptions
        )
        aparts = (native.Apart * max(1, len(found)))(*found)
        self._struct.aparts, self._struct.n_aparts = aparts, len(found)
        self._alive.append(aparts)

    def _inlets(self) -> c.Array[native.InletStruct]:
        inlets = (native.InletStruct * max(1, len(self._plan.inlets)))()
        for i, inlet in enumerate(self._plan.inlets):
            inlets[i] = self._inlet(inlet)
            self.gates[inlet.gate] = (
                native.address("inlet_pass"),
                c.addressof(inlets) + i * c.sizeof(native.InletStruct),
            )
        self._struct.inlets = inlets
        self._struct.n_inlets = len(self._plan.inlets)
        return inlets

    def _inlet(self, inlet: Inlet) -> native.InletStruct:
        line = self._line(inlet, self._system.messages[inlet.message])
        self.lines[inlet.target.name] = line
        initial = np.zeros(inlet.target.size)
        entry = native.InletStruct(
            node=c.addressof(self._struct),
            reception=c.pointer(self.receptions[inlet.message]),
            delay=c.pointer(line.struct),
            first=inlet.first,
            count=inlet.target.size,
            target=inlet.target.start,
            gain=inlet.gain,
            offset=inlet.offset,
            period=inlet.ticks // self._plan.ticks,
            held=-1,
            newest=-1,
            last_newest=-1,
            link_age=-1 if inlet.age is None else inlet.age.start,
            initial=initial.ctypes.data,
            later=self._plan.plan.component(inlet.component).kind == "continuous",
        )
        self._alive.append(initial)
        self._stale(entry, inlet)
        self._drive(entry, inlet)
        return entry

    def _line(self, inlet: Inlet, carried: Carried) -> DelayLine:
        plan, sent = self._system.plan, carried.outlet.ticks
        if inlet.link is not None and self._system.deployment.latency:
            spec = delays_for(inlet.link, plan.ticks, carried.outlet.period)
        else:
            edge = inlet.link or Wire(inlet.source, inlet.target)
            spec = zero_delay(edge, sent, inlet.ticks, plan.h)
        return spec.line(self._struct.phase_ns - carried.offset_ns)

    def _stale(self, entry: native.InletStruct, inlet: Inlet) -> None:
        d = self._system.deployment
        name = f"{inlet.component}.{inlet.target.port}"
        spec = self._spec.stale.get(name, StaleSpec())
        place = ("nodes", self._name, "stale", name)
        entry.age = -1
        period = self._system.messages[inlet.message].period_ns * 1e-9
        usual = max(d.silence, PERIODS * period) if d.silence > 0 else 0.0
        stop = usual if spec.stop is None else d.seconds(spec.stop, *place, "stop")
        entry.stop_ns = round(stop * 1e9)
        if entry.stop_ns > 0:
            self.receptions[inlet.message].awaited = 1
        if spec.age:
            entry.age = age_slot(self._plan, inlet, spec.age, d.place(*place, "age"))

    def _drive(self, entry: native.InletStruct, inlet: Inlet) -> None:
        spec, d = self._spec.drive, self._system.deployment
        entry.q = entry.dq = -1
        if spec is None or inlet.target.port != spec.port:
            return
        place = d.place("nodes", self._name, "drive")
        joints, component = inlet.target.size, inlet.component
        q, dq, tau = (
            input_of(self._plan, component, port, place).start
            for port in (spec.q, spec.dq, spec.port)
        )
        at = inlet.target.start - tau
        period = inlet.ticks * self._system.plan.h
        drive = emulated(spec, d).part(at, joints).build(joints, period, place)
        self.drives.append(drive)
        command = np.zeros(joints)
        entry.drive, entry.max_age_ns = c.pointer(drive.struct), torque_age(spec, d, place)
        entry.ignored = -1
        entry.command = command.ctypes.data
        entry.q, entry.dq = q + at, dq + at
        self._alive.append(command)
        self._follow(entry, inlet)

    def _follow(self, entry: native.InletStruct, inlet: Inlet) -> None:
        """The vendor's state machine of the drive behind an inlet, if it has one."""
        drive = drive_sequences.emulated(self._system.deployment, self._name, inlet)
        if drive is not None and drive.profile.vendor:
            self.motors.follow(entry, drive, entry.drive.contents)
