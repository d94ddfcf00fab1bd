"""Nodes in simulated time: processes whose buses and clock are those of simulated CAN buses.

The same nodes, codecs, guards and delay lines as on the wall clock. A node waits on its buses,
which the rehearsal serves, until its next deadline; time passes when all nodes wait. So each slot
has heard what had arrived by its deadline, and everything is the twin's, to the bit. A deployment
asks for it with ``clock = "simulated"``; its buses have the interface ``cosim``.
"""

from __future__ import annotations

import ctypes as c
from collections.abc import Callable, Mapping

from bridge.can.interface import Attachment
from bridge.deployment.gateways import gateways
from bridge.deployment.system import System
from bridge.native import node as native
from bridge.native.safety import LifeState
from bridge.node.buses import SIMULATED
from bridge.simulated_can.attachment import SimulatedAttachment
from bridge.wiring.wiring import WiredNode
from cosim.base.clock import sleep
from cosim.base.errors import ScenarioError

#: s between two looks at whether START has come.
LOOK = 0.001


def is_simulated(system: System) -> bool:
    """True if a deployment asks for simulated time. Raises ScenarioError where it cannot be."""
    d = system.deployment
    if d.clock != "simulated":
        return False
    for name, bus in d.buses.items():
        if bus.kind != "can" or bus.interface != SIMULATED:
            found = bus.interface if bus.kind == "can" else bus.kind
            raise ScenarioError(
                f"found {found} with the simulated clock, expected CAN with interface ="
                f' "{SIMULATED}"',
                d.place("buses", name),
            )
    if found_gateways := sorted(gateways(d)):
        text = "found a gateway, which the simulated clock does not support; expected components"
        raise ScenarioError(text, d.place("nodes", found_gateways[0]))
    for name in system.nodes:
        if not system.buses_of(name):
            text = "found a node without a bus, expected one, whose time it shares"
            raise ScenarioError(text, d.place("nodes", name))
    return True


def end_ns(system: System) -> int:
    """The deadline of the last slot of any node, ns."""
    d = system.deployment
    phases = {n: d.seconds(d.nodes[n].phase, "nodes", n, "phase") for n in system.nodes}
    return max(
        (plan.slots - 1) * round(plan.h * 1e9) + round(phases[name] * 1e9)
        for name, plan in system.nodes.items()
    )


def run_simulated(
    wired: WiredNode, buses: Mapping[str, Attachment], step: Callable[[], int] | None = None
) -> int:
    """All slots of a node; FINISHED, STOPPED, NEVER_STARTED or a result of the engine, as
    :mod:`bridge.native.node` has them.

    `step`: computes the next slot and returns a result of the engine; default: in this process.

    The node stays on its buses until the last slot of all nodes, so that no frame lacks an
    acknowledgement.
    """
    s = wired.struct
    ends = [end for end in buses.values() if isinstance(end, SimulatedAttachment)]
    while not s.told:
        if s.quit:
            return native.NEVER_STARTED
        sleep(LOOK)
    s.told = 0
    s.life.state, s.life.armed = LifeState.ACTIVE, 1
    native.functions().node_enable(c.byref(s), 0)
    while s.slot < s.slots:
        if s.quit:
            return native.STOPPED
        ends[0].wait_until(s.slot * s.h_ns + s.phase_ns)
        for end in ends:
            end.hear()
        if result := native.functions().node_step(c.byref(s)) if step is None else step():
            return int(result)
        for end in ends:
            end.send()
    ends[0].wait_until(end_ns(wired.system))
    for end in ends:
        end.hear()
    s.life.state = LifeState.FINISHED
    return native.FINISHED
