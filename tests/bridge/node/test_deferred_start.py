"""Drives that a node waits for: a START that is put off, and drives that fall silent."""

from __future__ import annotations

import ctypes as c

import pytest

from bridge.native.commanded import Failure, Phase
from bridge.native.node import functions
from bridge.native.safety import Command, LifeState
from tests.bridge.deployments import named
from tests.bridge.slots import Slots


@pytest.mark.parametrize(
    ("commands", "kept"),
    [
        ((), 1),
        ((Command.ARM,), 1),
        ((Command.STOP,), 0),
        ((Command.RESET,), 0),
        ((Command.RESET, Command.ARM), 0),  # armed again, but not for that START
    ],
)
def test_a_start_that_waits_is_forgotten_with_a_stop_or_a_reset(tmp_path, commands, kept):
    with Slots(named("can-damiao"), "master_control", tmp_path) as node:
        struct = node.struct
        for drive in node.wired.commanded.structs:
            drive.phase = Phase.RISING
        struct.life.state, struct.life.armed = LifeState.INACTIVE, 1
        functions().node_tell(c.byref(struct), Command.START)
        node.step()
        assert struct.deferred == 1 and struct.life.state == LifeState.INACTIVE
        for command in commands:
            functions().node_tell(c.byref(struct), command)
        node.step()
        assert struct.deferred == kept and struct.life.state != LifeState.ACTIVE


@pytest.mark.parametrize("start", [0, 7_000_000_000])
def test_a_drive_is_silent_by_the_clock_of_its_bus(tmp_path, start):
    """Its last word came 1 ms after t = 0, and it may be silent for 20 ms; slots are 5 ms apart."""
    with Slots(named("can-damiao"), "master_control", tmp_path) as node:
        node.struct.start_ns = start
        node.begin()
        drives = node.wired.commanded.structs
        for drive in drives:
            assert drive.phase == Phase.SERVING
            drive.told_ns, drive.within_ns = start + 1_000_000, 20_000_000
        found = []
        for _ in range(7):
            node.step()
            found.append({drive.failure for drive in drives})
        assert found == [{Failure.NOT}] * 5 + [{Failure.SILENT}] * 2
