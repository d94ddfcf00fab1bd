"""A fault script bound to a node that is wired: on the wall clock as in the twin."""

from __future__ import annotations

import ctypes as c
from pathlib import Path

from bridge.faults.script import FaultScript, NodeFaults
from bridge.native.faults import INJECTED
from bridge.native.journal import Journal
from bridge.wiring.wiring import WiredNode
from cosim.base.errors import ScenarioError

#: Rows of the record of what was done to frames.
ROWS = 100_000


def inject(wired: WiredNode, script: FaultScript, path: Path) -> NodeFaults | None:
    """Inject the faults of the script into frames that this node receives; None: no faults.

    The injected faults are recorded in `path`, a journal of INJECTED rows that is closed with the
    node.
    """
    _let_drives_suffer(wired, script)
    journal = Journal.create(path, INJECTED, ROWS)
    wired.keep(journal)
    system, name = wired.system, wired.name
    faults = script.frames_for(
        name,
        system.subscriptions(name),
        {bus: i for i, bus in enumerate(system.buses_of(name))},
        samples={m: system.messages[m].encoding.message for m in system.received_by(name)},
        journal=journal.address,
    )
    if faults is not None:
        wired.struct.faults = c.pointer(faults.injector.struct)
    return faults


def _let_drives_suffer(wired: WiredNode, script: FaultScript) -> None:
    """Faults of the emulated drives of this node. Raises ScenarioError for an unknown number.

    A drive of our own protocol has the number of its node, on each bus of that.
    """
    bindings, motors = wired.inlet_bindings, wired.inlet_bindings.motors
    own = [(bus, wired.spec.number) for bus in wired.system.buses_of(wired.name)]
    known = [(drive.bus, drive.node) for drive in motors.drives]
    known += own if bindings.own_drives else []
    for one in script.drives:
        numbers = [str(node) for bus, node in known if bus == one.bus]
        if numbers and str(one.drive) not in numbers:
            text = f"is {one.drive}; expected one of {', '.join(numbers)} on bus {one.bus}"
            raise ScenarioError(text, script.place(one.index, "drive"))
    mine = [f for f in script.drives if (f.bus, f.drive) in own]
    bindings.suffer([(f.t, int(f.fault), f.code) for f in mine])
    for bus, node in ((drive.bus, drive.node) for drive in motors.drives):
        mine = [f for f in script.drives if (f.bus, f.drive) == (bus, node)]
        motors.suffer(bus, node, [(f.t, int(f.fault), f.code) for f in mine])
