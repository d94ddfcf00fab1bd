"""The state in which a node begins in simulated time: in the middle of its work, or cold."""

from __future__ import annotations

import ctypes as c

from bridge.native import node as native
from bridge.native import vendor
from bridge.native.commanded import Phase
from bridge.native.safety import DriveState, LifeState
from bridge.wiring.wiring import WiredNode


def begin_active(node: WiredNode) -> None:
    """The node is ACTIVE with its next slot, its drives are enabled and fed."""
    s = node.struct
    s.life.state, s.life.armed = LifeState.ACTIVE, 1
    native.functions().node_enable(c.byref(s), s.slot * s.h_ns)


def begin_cold(node: WiredNode) -> None:
    """The node is INACTIVE with its next slot and waits for ARM; its drives have power only."""
    begin_active(node)
    s = node.struct
    s.life.state, s.life.armed = LifeState.INACTIVE, 0
    for drive in node.commanded.structs[: s.n_commanded]:
        drive.phase = Phase.RESTING
    for motor in node.inlet_bindings.motors.structs[: s.n_motors]:
        vendor.functions().vendor_init(c.byref(motor.vendor), s.slot * s.h_ns)
    for own in node.drives:
        own.struct.state = DriveState.READY
