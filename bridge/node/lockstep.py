"""Nodes in lock-step: no clock, every node as fast as the samples it needs arrive.

The same nodes, codecs and delay lines as on the wall clock; the result is the twin's to the last
bit, however long the network takes and wherever the nodes are. A deployment asks for it with
``options.lockstep = true`` of its Zenoh buses, and has no others: CAN may lose frames.

A node runs ahead of its peers by what the delays of its links allow (look-ahead), unless
``options.lookahead = false``.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, final

from bridge.can.interface import Attachment
from bridge.deployment.gateways import gateways
from bridge.deployment.system import System
from bridge.native import lockstep as native
from bridge.native import node as nodes
from bridge.native.bus import Bus, BusKind, BusStruct
from bridge.native.frame import Frame, Ring
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError

#: Frames of one slot, in and out: a message's whole start may come at once.
RING = 4096
#: s without a sample after which a node says what it waits for, if no option ``wait`` says.
PATIENCE = 30.0


def is_lockstep(system: System) -> bool:
    """True if a deployment asks for lock-step. Raises ScenarioError where it cannot be."""
    d = system.deployment
    asked = [name for name, bus in d.buses.items() if bus.options.get("lockstep")]
    others = [name for name in d.buses if name not in asked]
    if asked and others:
        raise ScenarioError(
            f"lockstep on {', '.join(asked)}, but not on {', '.join(others)}; expected all buses "
            "to be Zenoh with lockstep = true",
            d.place("buses"),
        )
    if asked and (found := sorted(gateways(d))):
        text = f"lock-step has no gateways, and {found[0]} is one; expected nodes with components"
        raise ScenarioError(text, d.place("nodes", found[0]))
    if asked and d.sync:
        raise ScenarioError("lock-step does not support SYNC", d.place("sync"))
    return bool(asked)


def looks_ahead(system: System) -> bool:
    """True if nodes run ahead of samples that the delays of links still hold back."""
    return all(bus.options.get("lookahead", True) for bus in system.deployment.buses.values())


def _patience(system: System) -> float:
    d = system.deployment
    said = {
        name: d.seconds(bus.options["wait"], "buses", name, "options", "wait")
        for name, bus in d.buses.items()
        if bus.options.get("wait")
    }
    return max(said.values(), default=PATIENCE)


@final
class Lockstep:
    """One node in lock-step over its `ends`; use as a context manager.

    `wired` is the node, `streams` (messages received,) are its samples, `outside` its buses.
    """

    def __init__(
        self,
        system: System,
        name: str,
        ends: Mapping[str, Attachment],
        journal: Path,
    ) -> None:
        self._system, self._name = system, name
        self._ahead = looks_ahead(system)
        self._patience = _patience(system)
        inside = {
            bus: Bus.from_rings(Ring(RING), Ring(RING), number, kind=BusKind.MEMORY)
            for number, bus in enumerate(system.buses_of(name))
        }
        self.wired = WiredNode(system, name, inside, journal, nodes.SIMULATED)
        self.wired.struct.heartbeat_slots = self.wired.struct.n_peers = 0
        heard = system.received_by(name)
        self.streams = (native.StreamStruct * len(heard))(*map(self._stream, heard))
        structs = [end.bus.struct for end in ends.values()]
        self._outside = (BusStruct * max(1, len(structs)))(*structs)
        self.outside = {name: end.bus for name, end in ends.items()}
        for i, bus in enumerate(self.outside.values()):
            bus.struct = self._outside[i]
        self.struct = native.LockstepStruct(
            node=c.pointer(self.wired.struct),
            outside=self._outside,
            streams=self.streams,
            n_streams=len(heard),
            awaited=-1,
            patience_ns=round(self._patience * 1e9),
            until_ns=native.TO_END,
        )

    def __enter__(self) -> Self:
        self.wired.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        self.wired.__exit__(*raised)

    def _stream(self, message: str) -> native.StreamStruct:
        system = self._system
        carried, order = system.messages[message], list(system.nodes)
        capacity = -(-system.plan.ticks // carried.outlet.ticks)
        return native.StreamStruct(
            message=c.pointer(carried.encoding.message),
            bus=system.buses_of(self._name).index(carried.bus),
            before=order.index(carried.node) < order.index(self._name),
            period_ns=carried.period_ns,
            offset_ns=carried.offset_ns,
            lead_ns=self._lead(message) if self._ahead else 0,
            reception=c.pointer(self.wired.inlet_bindings.receptions[message]),
            capacity=capacity,
            frames=(Frame * capacity)(),
        )

    def _lead(self, message: str) -> int:
        """The time after which a sample that was sent has its first effect here, ns."""
        bindings, plan = self.wired.inlet_bindings, self.wired.plan
        leads = [
            0 if struct.drive else self.wired.lines[inlet.target.name].lead_ns
            for inlet, struct in zip(plan.inlets, bindings.inlets, strict=False)
            if inlet.message == message
        ]
        return min(leads, default=0)

    def run(self) -> int:
        """To the end; what :func:`bridge.native.lockstep.run` returns."""
        return native.run(self.struct)

    def error(self, result: int) -> str:
        """The sample that did not come; "" where it ended for another reason."""
        s = self.wired.struct
        if result not in (native.STALLED, native.LOST, native.REFUSED):
            return ""
        stream = self.streams[self.struct.awaited]
        message = self._system.received_by(self._name)[self.struct.awaited]
        sender = self._system.messages[message].node
        at = f"slot {s.slot} (t = {s.slot * s.h:.6g} s)"
        if result == native.LOST:
            return (
                f"{at}: sample {stream.received} of {message} from node {sender} is lost: number "
                f"{self.struct.found} (modulo 65536) came; did {sender} start again?"
            )
        if result == native.REFUSED:
            return (
                f"{at}: sample {stream.given - 1} of {message} from node {sender} (or one just "
                "before it) is outside its range or rate, but slots before this one counted it as "
                "received; expected only samples that are accepted, or options.lookahead = false"
            )
        return (
            f"{at}: waits for sample {stream.received} of {message} from node {sender}; nothing "
            f"new for {self._patience:g} s: it stalls, or is gone"
        )
