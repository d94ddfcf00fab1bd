"""The last torque of each arm is zero, whatever else its node sends."""

from __future__ import annotations

import pytest

from bridge.native.frame import Frame
from bridge.native.node import FINISHED, STOPPED
from tests.bridge.deployments import document
from tests.bridge.node.test_late_slots import Live

LAST = 19  # slot of a run


def frames(node):
    """All that it has sent."""
    frame, found = Frame(), []
    for ring in node.sent.values():
        while ring.get(frame):
            found.append(Frame.from_buffer_copy(frame))
    return found


@pytest.mark.parametrize("last", [6, LAST])
def test_behind_the_last_slot_every_torque_is_zero_and_has_the_next_number(tmp_path, last):
    """The controllers of two arms in a node, which is left in slot `last`, or at its end."""
    found = document("can-classic")
    del found["nodes"]["slave_control"]
    found["nodes"]["master_control"]["components"] = ["master_control", "slave_control"]

    def each(node):
        node.struct.quit = node.struct.slot == last < LAST

    node = Live(tmp_path, each, found=found)
    rows = node.live()
    assert node.result == (FINISHED if last == LAST else STOPPED) and len(rows) == last + 1
    sent, guarded = frames(node), set()
    for outlet, entry in zip(node.wired.plan.outlets, node.struct.outlets, strict=False):
        codec = node.system.messages[outlet.message].encoding
        said = [codec.decode(f.payload)[1:] for f in sent if f.id == codec.message.id]
        numbers = range(last + 1 + bool(entry.guard))
        assert [header.counter for _, header in said] == [k % 16 for k in numbers]
        if entry.guard:
            guarded.add(outlet.message)
            assert not any(said[-1][0]) and any(said[-2][0])
    assert guarded == {"TAU_2", "TAU_4"}
